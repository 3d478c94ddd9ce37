"use strict";
// Reads the images and maps that the page holds; the format is described in fovden/report/coding.py.

const NAN_CODE = -32768;
const LARGEST_CODE = 32767; // of infinities

const ESCAPE = 0xe000;

// A character holds two bytes; after an escape its highest bit is turned over. The first one says how many of the last
// bytes are filling.
function readText(text) {
  const units = new Uint16Array(text.length - 1);
  let count = 0;
  for (let at = 1; at < text.length; at++) {
    const unit = text.charCodeAt(at);
    units[count++] = unit === ESCAPE ? text.charCodeAt(++at) ^ 0x8000 : unit;
  }
  const bytes = new Uint8Array(2 * count);
  for (let i = 0; i < count; i++) {
    bytes[2 * i] = units[i];
    bytes[2 * i + 1] = units[i] >>> 8;
  }
  return bytes.subarray(0, bytes.length - Number(text[0]));
}

async function inflate(id) {
  const packed = readText(document.getElementById(id).textContent);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Adds its prediction to each difference: a + b - c of the neighbours left, above, and left above, between a and b.
// What is copied has its value already; `copied` has one entry for each pixel of all views, or is null.
function integrate(values, width, height, copied = null) {
  const isStored = copied ? (i) => copied[i % copied.length] === 0 : () => true;
  for (let plane = 0; plane < values.length; plane += width * height) {
    for (let x = 1; x < width; x++) if (isStored(plane + x)) values[plane + x] += values[plane + x - 1];
    for (let row = plane + width; row < plane + width * height; row += width) {
      if (isStored(row)) values[row] += values[row - width];
      for (let i = row + 1; i < row + width; i++) {
        if (!isStored(i)) continue;
        const a = values[i - 1], b = values[i - width];
        const low = a < b ? a : b, high = a < b ? b : a;
        const plain = a + b - values[i - width - 1];
        values[i] += plain < low ? low : plain > high ? high : plain;
      }
    }
  }
}

// Codes of all views: three planes, red, green, blue, each in the order view, row, column. An image that is like an
// earlier one has the codes of that, `like`, where `copied` is 1.
async function readImage(id, pixels, width, height, like = null, copied = null) {
  const data = await inflate(id);
  const size = (data.length - 1) / 2;
  const stored = new Int16Array(3 * pixels);
  for (let i = 0, from = 1; i < 3 * pixels; i++) {
    const pixel = i % pixels;
    if (copied?.[pixel]) {
      const green = like[pixels + pixel];
      stored[i] = i < pixels ? green : i < 2 * pixels ? like[pixel] - green : like[i] - green;
    } else {
      const folded = data[from] | (data[size + from++] << 8);
      stored[i] = (folded >>> 1) ^ -(folded & 1);
    }
  }
  if (data[0] === 1) integrate(stored, width, height, copied);
  const codes = new Int16Array(3 * pixels);
  for (let i = 0; i < pixels; i++) {
    const green = stored[i];
    codes[i] = green + stored[pixels + i];
    codes[pixels + i] = green;
    codes[2 * pixels + i] = green + stored[2 * pixels + i];
  }
  return codes;
}

async function readMap(id, width, height) {
  const data = await inflate(id);
  const values = data.slice(1);
  if (data[0] === 1) integrate(values, width, height);
  return values;
}
