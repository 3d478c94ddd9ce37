"use strict";
// Reads the images and maps that the page holds; the format is described in fovden/report/coding.py.

const NAN_CODE = -32768;
const LARGEST_CODE = 32767; // of infinities

// Five letters to the base 85 make four bytes; the first letter says how many of the last bytes are filling.
function readText(text) {
  const words = Math.floor(text.length / 5);
  const bytes = new Uint8Array(4 * words);
  for (let word = 0, at = 1; word < words; word++) {
    let value = 0;
    for (const end = at + 5; at < end; at++) {
      const letter = text.charCodeAt(at) - 35;
      value = 85 * value + letter - (letter > 25 ? 1 : 0);
    }
    bytes[4 * word] = value >>> 24;
    bytes[4 * word + 1] = value >>> 16;
    bytes[4 * word + 2] = value >>> 8;
    bytes[4 * word + 3] = value;
  }
  return bytes.subarray(0, bytes.length - Number(text[0]));
}

async function inflate(id) {
  const packed = readText(document.getElementById(id).textContent);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Adds its prediction to each difference: a + b - c of the neighbours left, above, and left above, between a and b.
function integrate(values, width, height) {
  for (let plane = 0; plane < values.length; plane += width * height) {
    for (let x = 1; x < width; x++) values[plane + x] += values[plane + x - 1];
    for (let row = plane + width; row < plane + width * height; row += width) {
      values[row] += values[row - width];
      for (let i = row + 1; i < row + width; i++) {
        const a = values[i - 1], b = values[i - width];
        const low = a < b ? a : b, high = a < b ? b : a;
        const plain = a + b - values[i - width - 1];
        values[i] += plain < low ? low : plain > high ? high : plain;
      }
    }
  }
}

// Codes of all views: three planes, red, green, blue, each in the order view, row, column.
async function readImage(id, pixels, width, height) {
  const data = await inflate(id);
  const size = 3 * pixels;
  const stored = new Int16Array(size);
  for (let i = 0; i < size; i++) {
    const folded = data[1 + i] | (data[1 + size + i] << 8);
    stored[i] = (folded >>> 1) ^ -(folded & 1);
  }
  if (data[0] === 1) integrate(stored, width, height);
  const codes = new Int16Array(size);
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
