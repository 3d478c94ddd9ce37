"use strict";
// Decoded images and the canvases painted from them.
class Pictures {
  constructor(report) {
    Object.assign(this, report);
    this.pixels = this.views * this.width * this.height;
    this.radiance = radianceTable(this.steps, this.knee);
    this.map = colourTable(report.colours);
    this.codes = this.images.map(() => null);
    this.maps = new Map();
    this.painted = new Map();
    this.errors = new Map();
    this.ends = Object.fromEntries(this.scales.map((scale) => [scale.name, scale.end]));
    this.setStops(0);
  }

  setStops(stops) {
    this.stops = stops;
    this.shownExposure = this.exposure * Math.pow(2, stops);
    this.display = displayTable(this.radiance, this.shownExposure);
    this.forget("image");
    this.forget("display");
  }

  scale(name) {
    const found = this.scales.find((scale) => scale.name === name);
    return { ...found, end: this.ends[name] };
  }

  forget(mode) {
    for (const key of this.painted.keys()) if (key.endsWith(mode)) this.painted.delete(key);
    for (const key of this.errors.keys()) if (key.endsWith(mode)) this.errors.delete(key);
  }

  rescale(name, factor) {
    this.ends[name] *= factor;
    for (const key of this.painted.keys()) if (key.endsWith(name)) this.painted.delete(key);
  }

  async load(index) {
    const image = this.images[index];
    if (this.codes[index] === null) {
      if (image.like !== null) await this.load(image.like);
      const copied = image.copied && (await readMap(image.copied, this.width, this.height));
      const like = image.like === null ? null : this.codes[image.like];
      this.codes[index] = await readImage(image.data, this.pixels, this.width, this.height, like, copied);
    }
    for (const id of [image.samples, image.flip, this.layer]) {
      if (id && !this.maps.has(id)) this.maps.set(id, await readMap(id, this.width, this.height));
    }
  }

  isLoaded(index) {
    return this.codes[index] !== null;
  }

  // Whether an image has an error map of this kind; the reference has none.
  hasError(index, mode) {
    if (mode === "image" || this.reference === null || index === this.reference) return false;
    return mode !== "flip" || Boolean(this.images[index].flip);
  }

  errorsOf(index, mode) {
    const key = `${index} ${mode}`;
    if (!this.errors.has(key)) {
      const codes = this.codes[index], truth = this.codes[this.reference];
      let errors;
      if (mode === "flip") errors = Float32Array.from(this.maps.get(this.images[index].flip), (level) => level / this.flip_levels);
      else if (mode === "display") errors = displayError(codes, truth, this.pixels, this.display);
      else errors = relativeError(codes, truth, this.pixels, this.radiance, this.relative_eps);
      this.errors.set(key, errors);
    }
    return this.errors.get(key);
  }

  // Canvases of all views, painted when first asked for.
  canvases(index, mode) {
    if (!this.isLoaded(index)) return null;
    const error = this.hasError(index, mode);
    if (error && !this.isLoaded(this.reference)) return null;
    const key = `${index} ${error ? mode : "image"}`;
    if (!this.painted.has(key)) {
      const made = [];
      for (let view = 0; view < this.views; view++) {
        const canvas = document.createElement("canvas");
        canvas.width = this.width;
        canvas.height = this.height;
        const data = error
          ? paintErrors(this.errorsOf(index, mode), this.width, this.height, view, this.scale(mode), this.map, this.no_value)
          : shade(this.codes[index], this.pixels, this.width, this.height, view, this.display, this.no_value);
        canvas.getContext("2d").putImageData(data, 0, 0);
        made.push(canvas);
      }
      this.painted.set(key, made);
    }
    return this.painted.get(key);
  }

  at(view, x, y) {
    return (view * this.height + y) * this.width + x;
  }

  values(index, view, x, y) {
    const at = this.at(view, x, y);
    return [0, 1, 2].map((channel) => this.radiance[this.codes[index][channel * this.pixels + at] & 0xffff]);
  }
}
