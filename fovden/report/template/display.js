"use strict";
// From codes to radiance, and from radiance to what a display shows: exposure, the sRGB curve, a clamp to [0, 1].

// One entry for each of the 65536 codes, in the order of the codes as unsigned integers.
function tabulate(make, type) {
  const table = new type(65536);
  for (let i = 0; i < 65536; i++) table[i] = make((i << 16) >> 16);
  return table;
}

function radianceTable(steps, knee) {
  return tabulate((code) => {
    if (code === NAN_CODE) return NaN;
    if (Math.abs(code) === LARGEST_CODE) return Math.sign(code) * Infinity;
    return Math.sign(code) * knee * (Math.pow(2, Math.abs(code) / steps) - 1);
  }, Float64Array);
}

function encodeSrgb(linear) {
  const encoded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * Math.pow(linear, 1 / 2.4) - 0.055;
  return Math.min(1, Math.max(0, encoded));
}

// Display values in [0, 1] by code, at an exposure.
function displayTable(radiance, exposure) {
  return tabulate((code) => encodeSrgb(radiance[code & 0xffff] * exposure), Float32Array);
}

// One view as pixels for a canvas; `noValue` is the colour of what is not a number.
function shade(codes, pixels, width, height, view, display, noValue) {
  const levels = new Uint8Array(65536);
  for (let i = 0; i < 65536; i++) levels[i] = Math.floor(display[i] * 255 + 0.5);
  const image = new ImageData(width, height);
  const out = image.data;
  const count = width * height;
  for (let i = 0, from = view * count, to = 0; i < count; i++, from++, to += 4) {
    const r = codes[from], g = codes[pixels + from], b = codes[2 * pixels + from];
    const sound = r !== NAN_CODE && g !== NAN_CODE && b !== NAN_CODE;
    out[to] = sound ? levels[r & 0xffff] : noValue[0];
    out[to + 1] = sound ? levels[g & 0xffff] : noValue[1];
    out[to + 2] = sound ? levels[b & 0xffff] : noValue[2];
    out[to + 3] = 255;
  }
  return image;
}

// Root mean square over R, G and B of the difference of display values, of every pixel of every view.
function displayError(codes, truth, pixels, display) {
  const errors = new Float32Array(pixels);
  for (let i = 0; i < pixels; i++) {
    let sum = 0;
    for (let at = i; at < 3 * pixels; at += pixels) {
      const difference = display[codes[at] & 0xffff] - display[truth[at] & 0xffff];
      sum += difference * difference;
    }
    errors[i] = Math.sqrt(sum / 3);
  }
  return errors;
}

// Mean over R, G and B of (image - reference)^2 / (reference^2 + eps).
function relativeError(codes, truth, pixels, radiance, eps) {
  const errors = new Float32Array(pixels);
  for (let i = 0; i < pixels; i++) {
    let sum = 0;
    for (let at = i; at < 3 * pixels; at += pixels) {
      const wanted = radiance[truth[at] & 0xffff];
      const difference = radiance[codes[at] & 0xffff] - wanted;
      sum += (difference * difference) / (wanted * wanted + eps);
    }
    errors[i] = sum / 3;
  }
  return errors;
}

// A scale maps errors to [0, 1]: linear from 0, or logarithmic over some decades below its end.
function scalePosition(value, scale) {
  if (!scale.decades) return value / scale.end;
  return value > 0 ? 1 + Math.log10(value / scale.end) / scale.decades : 0;
}

function colourTable(hex) {
  return Uint8Array.from({ length: hex.length / 2 }, (_, i) => parseInt(hex.slice(2 * i, 2 * i + 2), 16));
}

function paintErrors(errors, width, height, view, scale, colours, noValue) {
  const image = new ImageData(width, height);
  const out = image.data;
  const count = width * height;
  for (let i = 0, to = 0; i < count; i++, to += 4) {
    const value = errors[view * count + i];
    const at = Math.round(255 * Math.min(1, Math.max(0, scalePosition(value, scale))));
    for (let c = 0; c < 3; c++) out[to + c] = Number.isNaN(value) ? noValue[c] : colours[3 * at + c];
    out[to + 3] = 255;
  }
  return image;
}
