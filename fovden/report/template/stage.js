"use strict";
// The panes, one for each eye, with one zoom, one pan and one split for all of them.

const LARGEST_SCALE = 128; // screen pixels per image pixel
const NUMBERS_FROM = 72; // the same, from which on each pixel shows its values
const LAYER_COLOURS = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442"]; // Okabe and Ito's palette

class Stage {
  // `scene` answers: sources(view) -> {left, right} canvases, numbers(view, x, y) -> texts, and has gaze and radii.
  constructor(element, size, eyes, scene, onPoint) {
    this.element = element;
    this.width = size.width;
    this.height = size.height;
    this.scene = scene;
    this.onPoint = onPoint;
    this.visible = eyes.map((_, view) => view);
    this.fitted = true;
    this.scale = 1;
    this.centre = [size.width / 2, size.height / 2];
    this.split = 0.5;
    this.splitting = false;
    this.circles = false;
    this.pointed = null;
    this.pointers = new Map();
    this.panes = eyes.map((eye, view) => this.makePane(eye, view));
    this.arrange();
    new ResizeObserver(() => this.resize()).observe(element);
  }

  makePane(eye, view) {
    const pane = document.createElement("div");
    pane.className = "pane";
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", eye);
    const left = document.createElement("span");
    left.className = "label left";
    const right = document.createElement("span");
    right.className = "label right";
    const handle = document.createElement("div");
    handle.className = "handle";
    handle.tabIndex = 0;
    handle.setAttribute("role", "slider");
    handle.setAttribute("aria-label", `Split, ${eye}`);
    handle.setAttribute("aria-valuemin", "0");
    handle.setAttribute("aria-valuemax", "100");
    pane.append(canvas, left, right, handle);
    const made = { pane, canvas, left, right, handle, eye, view };
    this.listen(made);
    return made;
  }

  // Shows the views in the given order.
  arrange(order = this.visible) {
    this.visible = order;
    this.element.replaceChildren(...order.map((view) => this.panes[view].pane));
    this.resize();
  }

  resize() {
    const box = this.element.getBoundingClientRect();
    if (!box.width || !box.height) return;
    this.paneWidth = (box.width - 8 * (this.visible.length - 1)) / this.visible.length;
    this.paneHeight = box.height;
    const ratio = window.devicePixelRatio || 1;
    for (const view of this.visible) {
      const canvas = this.panes[view].canvas;
      canvas.width = Math.max(1, Math.round(this.paneWidth * ratio));
      canvas.height = Math.max(1, Math.round(this.paneHeight * ratio));
    }
    this.fit = Math.min(this.paneWidth / this.width, this.paneHeight / this.height);
    if (this.fitted) this.reset();
    else this.zoomTo(this.scale);
  }

  reset() {
    this.fitted = true;
    this.scale = this.fit;
    this.centre = [this.width / 2, this.height / 2];
    this.draw();
  }

  // Changes the scale so that the image point under (x, y), in the pane, stays there.
  zoomTo(scale, x = this.paneWidth / 2, y = this.paneHeight / 2) {
    const [u, v] = this.toImage(x, y);
    this.scale = Math.min(LARGEST_SCALE, Math.max(this.fit, scale));
    this.fitted = this.scale <= this.fit;
    this.centre = [u - (x - this.paneWidth / 2) / this.scale, v - (y - this.paneHeight / 2) / this.scale];
    this.keepInside();
    this.draw();
  }

  pan(dx, dy) {
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] - dy / this.scale];
    this.keepInside();
    this.draw();
  }

  keepInside() {
    const keep = (value, size, shown) =>
      shown >= size ? size / 2 : Math.min(size - shown / 2, Math.max(shown / 2, value));
    this.centre = [
      keep(this.centre[0], this.width, this.paneWidth / this.scale),
      keep(this.centre[1], this.height, this.paneHeight / this.scale),
    ];
  }

  toImage(x, y) {
    return [
      this.centre[0] + (x - this.paneWidth / 2) / this.scale,
      this.centre[1] + (y - this.paneHeight / 2) / this.scale,
    ];
  }

  // Left edge and width, in the pane, of what is seen of the image.
  extent() {
    const left = Math.max(0, this.paneWidth / 2 - this.centre[0] * this.scale);
    const right = Math.min(this.paneWidth, this.paneWidth / 2 + (this.width - this.centre[0]) * this.scale);
    return [left, right - left];
  }

  listen({ pane, canvas, handle, view }) {
    const place = (event) => {
      const box = pane.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.zoomTo(this.scale * Math.pow(2, (-event.deltaY * lines) / 300), ...place(event));
      this.point(view, ...place(event));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      if (event.button === 2) this.scene.hold(true);
      else this.pointers.set(event.pointerId, place(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = place(event);
      this.point(view, ...now);
      if (!this.pointers.has(event.pointerId)) return;
      const before = [...this.pointers.values()];
      const old = this.pointers.get(event.pointerId);
      this.pointers.set(event.pointerId, now);
      if (before.length === 1) this.pan(now[0] - old[0], now[1] - old[1]);
      else this.pinch(before, [...this.pointers.values()]);
    });
    const end = (event) => {
      this.pointers.delete(event.pointerId);
      if (event.button === 2 || event.type === "pointercancel") this.scene.hold(false);
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("pointerleave", () => this.point(null));

    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      this.splitAt(place(event)[0] / this.paneWidth);
    });
    handle.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.01, ArrowRight: 0.01, PageDown: -0.1, PageUp: 0.1 }[event.key];
      const end = { Home: 0, End: 1 }[event.key];
      if (step === undefined && end === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      this.splitAt(end ?? this.split + step);
    });
  }

  pinch(before, after) {
    const middle = (points) => [(points[0][0] + points[1][0]) / 2, (points[0][1] + points[1][1]) / 2];
    const spread = (points) => Math.hypot(points[0][0] - points[1][0], points[0][1] - points[1][1]) || 1;
    const from = middle(before), to = middle(after);
    this.pan(to[0] - from[0], to[1] - from[1]);
    this.zoomTo((this.scale * spread(after)) / spread(before), ...to);
  }

  splitAt(share) {
    this.split = Math.min(1, Math.max(0, share));
    this.draw();
  }

  // Says which pixel is under the pointer.
  point(view, x, y) {
    let pointed = null;
    if (view !== null) {
      const [u, v] = this.toImage(x, y).map(Math.floor);
      if (u >= 0 && v >= 0 && u < this.width && v < this.height) {
        pointed = { view, x: u, y: v, right: this.splitting && x > this.split * this.paneWidth };
      }
    }
    this.pointed = pointed;
    this.onPoint(pointed);
    this.draw();
  }

  draw() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      for (const view of this.visible) this.drawPane(this.panes[view]);
      this.element.dispatchEvent(new Event("drawn"));
    });
  }

  drawPane(pane) {
    const { canvas, view } = pane;
    const ratio = window.devicePixelRatio || 1;
    const context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    const scale = this.scale * ratio;
    const x = Math.round(canvas.width / 2 - this.centre[0] * scale);
    const y = Math.round(canvas.height / 2 - this.centre[1] * scale);
    const shown = this.scene.sources(view);
    const border = this.splitting ? Math.round(this.split * canvas.width) : canvas.width;
    context.imageSmoothingEnabled = scale < 1; // magnified pixels stay squares
    context.imageSmoothingQuality = "high";
    for (const [source, from, to] of [[shown.left, 0, border], [shown.right, border, canvas.width]]) {
      if (!source || to <= from) continue;
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, canvas.height);
      context.clip();
      context.drawImage(source, x, y, Math.round(this.width * scale), Math.round(this.height * scale));
      context.restore();
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const toPane = (u, v) => [
      this.paneWidth / 2 + (u - this.centre[0]) * this.scale,
      this.paneHeight / 2 + (v - this.centre[1]) * this.scale,
    ];
    if (this.scale >= NUMBERS_FROM) this.drawNumbers(context, view, toPane);
    if (this.circles) this.drawCircles(context, view, toPane);
    if (this.pointed && this.scale >= 6) this.drawPointed(context, view, toPane);
    this.placeLabels(pane, shown);
  }

  drawNumbers(context, view, toPane) {
    const [u0, v0] = this.toImage(0, 0).map(Math.floor);
    const [u1, v1] = this.toImage(this.paneWidth, this.paneHeight).map(Math.ceil);
    const size = Math.min(15, this.scale / 6.5);
    context.font = `${size}px ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineJoin = "round";
    context.lineWidth = 2.5;
    context.strokeStyle = "rgba(0, 0, 0, 0.8)";
    for (let v = Math.max(0, v0); v < Math.min(this.height, v1); v++) {
      for (let u = Math.max(0, u0); u < Math.min(this.width, u1); u++) {
        const [x, y] = toPane(u + 0.5, v + 0.5);
        const lines = this.scene.numbers(view, u, v, this.splitting && x > this.split * this.paneWidth);
        lines.forEach(([text, colour], line) => {
          const down = y + (line - (lines.length - 1) / 2) * size * 1.3;
          context.strokeText(text, x, down);
          context.fillStyle = colour;
          context.fillText(text, x, down);
        });
      }
    }
  }

  drawCircles(context, view, toPane) {
    const { gaze, radii } = this.scene;
    const [x, y] = toPane(...gaze[view]);
    const strokes = (trace, colour) => {
      for (const [width, style] of [[4, "rgba(255, 255, 255, 0.85)"], [2, colour]]) {
        context.lineWidth = width;
        context.strokeStyle = style;
        context.beginPath();
        trace();
        context.stroke();
      }
    };
    radii.forEach((radius, layer) => {
      const reach = radius * this.scale;
      const colour = LAYER_COLOURS[layer % LAYER_COLOURS.length];
      strokes(() => context.arc(x, y, reach, 0, 2 * Math.PI), colour);
      context.font = "600 13px system-ui, sans-serif";
      context.textAlign = "center";
      context.textBaseline = "bottom";
      const text = `layer ${layer}: within ${Number(radius.toFixed(1))} px`;
      const above = Math.max(y - reach - 6, 58);
      const wide = context.measureText(text).width + 12;
      context.fillStyle = "rgba(0, 0, 0, 0.62)";
      context.fillRect(x - wide / 2, above - 17, wide, 20);
      context.fillStyle = colour;
      context.fillText(text, x, above);
    });
    strokes(() => {
      context.moveTo(x - 9, y);
      context.lineTo(x + 9, y);
      context.moveTo(x, y - 9);
      context.lineTo(x, y + 9);
    }, "#222222");
  }

  // The pixel under the pointer, in every eye.
  drawPointed(context, view, toPane) {
    const [x, y] = toPane(this.pointed.x, this.pointed.y);
    for (const [width, style] of [[3, "rgba(0, 0, 0, 0.7)"], [1.5, "#ffffff"]]) {
      context.lineWidth = width;
      context.strokeStyle = style;
      context.strokeRect(x, y, this.scale, this.scale);
    }
  }

  placeLabels({ left, right, handle, eye }, shown) {
    const [start, width] = this.extent();
    left.textContent = this.panes.length > 1 ? `${eye} · ${shown.leftName}` : shown.leftName;
    right.textContent = shown.rightName ?? "";
    left.style.left = `${start}px`;
    right.style.right = `${this.paneWidth - start - width}px`;
    right.hidden = handle.hidden = !this.splitting;
    handle.style.left = `${this.split * 100}%`;
    handle.setAttribute("aria-valuenow", String(Math.round(this.split * 100)));
  }
}
