"use strict";
// What is shown, how, and what the keys do.

const report = JSON.parse(document.getElementById("report").textContent);
const find = (id) => document.getElementById(id);

const pictures = new Pictures(report);
const names = report.images.map((image) => image.name);
const state = { image: 0, before: 0, peek: null, held: false, mode: "image", split: "" };

// The image under the pointer in the list, or the reference while it is held, stands in for the chosen one.
function current() {
  if (state.held && report.reference !== null) return report.reference;
  return state.peek ?? state.image;
}

function splitPartner() {
  if (state.split === "error") return [current(), state.mode === "image" ? report.scales[0].name : "image"];
  return [Number(state.split), state.mode];
}

function nameOf(index, mode) {
  const title = report.scales.find((scale) => scale.name === mode)?.title;
  return pictures.hasError(index, mode) ? `${title} of ${names[index]}` : names[index];
}

const scene = {
  gaze: report.gaze,
  radii: report.radii,
  hold: (held) => change({ held }),
  sources(view) {
    const index = current();
    const shown = { left: pictures.canvases(index, state.mode)?.[view], leftName: nameOf(index, state.mode) };
    if (state.split !== "") {
      const [other, mode] = splitPartner();
      shown.right = pictures.canvases(other, mode)?.[view];
      shown.rightName = nameOf(other, mode);
    }
    return shown;
  },
  numbers(view, x, y, right) {
    const [index, mode] = right ? splitPartner() : [current(), state.mode];
    if (!pictures.isLoaded(index)) return [];
    if (pictures.hasError(index, mode)) {
      return [[format(pictures.errorsOf(index, mode)[pictures.at(view, x, y)]), "#ffffff"]];
    }
    const colours = ["#ff9d9d", "#9dff9d", "#a8c8ff"];
    return pictures.values(index, view, x, y).map((value, channel) => [format(value), colours[channel]]);
  },
};

// Three digits are what the storage keeps.
function format(value) {
  if (Number.isNaN(value)) return "NaN";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "-∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 0.001 && size < 10000 ? String(Number(value.toPrecision(3))) : value.toExponential(2);
}

const stage = new Stage(find("stage"), report, report.eyes, scene, showValues);

function showValues(pointed) {
  find("hint").hidden = Boolean(pointed);
  find("values").hidden = !pointed;
  if (!pointed) return;
  const { view, x, y, right } = pointed;
  const index = right ? splitPartner()[0] : current();
  find("place").textContent = `${report.eyes[view]}  x ${x}  y ${y}`;
  const show = (row, which) => {
    const loaded = which !== null && pictures.isLoaded(which);
    find(row).hidden = !loaded;
    if (!loaded) return;
    const values = pictures.values(which, view, x, y);
    find(`${row}-name`).textContent = names[which];
    ["r", "g", "b"].forEach((channel, c) => (find(`${row}-${channel}`).textContent = format(values[c])));
    const shown = values.map((value) => Math.floor(encodeSrgb(value * pictures.shownExposure) * 255 + 0.5));
    find(`${row}-swatch`).style.background = `rgb(${values.some(Number.isNaN) ? report.no_value : shown})`;
  };
  show("own", index);
  show("truth", index === report.reference ? null : report.reference);
  const details = [];
  const at = pictures.at(view, x, y);
  const samples = pictures.maps.get(report.images[index].samples);
  if (samples) details.push(`samples ${samples[at]}`);
  const layer = pictures.maps.get(report.layer);
  if (layer) details.push(`layer ${layer[at]}`);
  const mode = state.mode === "image" ? report.scales[0]?.name : state.mode;
  if (mode && pictures.hasError(index, mode) && pictures.isLoaded(index) && pictures.isLoaded(report.reference)) {
    details.push(`${pictures.scale(mode).title} ${format(pictures.errorsOf(index, mode)[at])}`);
  }
  find("details").textContent = details.join("  ");
}

// Draws the colour bar of the error map in use, with its ends and its label.
function drawBar() {
  const bar = find("bar");
  bar.hidden = !report.scales.some((scale) => scale.name === state.mode);
  if (bar.hidden) return;
  const scale = pictures.scale(state.mode);
  const canvas = find("bar-colours");
  const context = canvas.getContext("2d");
  for (let x = 0; x < canvas.width; x++) {
    const at = 3 * Math.round((255 * x) / (canvas.width - 1));
    context.fillStyle = `rgb(${pictures.map.slice(at, at + 3).join(",")})`;
    context.fillRect(x, 0, 1, canvas.height);
  }
  const steps = scale.decades || 4;
  const ticks = [...Array(steps + 1).keys()].map((step) => {
    const value = scale.decades ? scale.end * Math.pow(10, step - steps) : (scale.end * step) / steps;
    const tick = document.createElement("span");
    const ends = (step === steps && scale.end < scale.most) || (step === 0 && scale.decades);
    tick.textContent = (ends ? (step ? "≥ " : "≤ ") : "") + format(value);
    tick.style.left = `${(100 * step) / steps}%`;
    return tick;
  });
  find("bar-ticks").replaceChildren(...ticks);
  find("bar-label").textContent = scale.label;
}

// Loads what is shown, then draws; called after every change.
async function refresh() {
  const wanted = new Set([current()]);
  if (state.split !== "") wanted.add(splitPartner()[0]);
  if (report.reference !== null) wanted.add(report.reference);
  const missing = [...wanted].filter((index) => !pictures.isLoaded(index));
  stage.splitting = state.split !== "";
  stage.draw();
  drawBar();
  document.querySelectorAll("#images button").forEach((button, index) => {
    button.setAttribute("aria-pressed", String(index === state.image));
    button.classList.toggle("shown", index === current());
  });
  if (missing.length) {
    find("stage").setAttribute("aria-busy", "true");
    for (const index of missing) await pictures.load(index);
    stage.draw();
  }
  find("stage").setAttribute("aria-busy", "false");
  showValues(stage.pointed);
}

function change(values) {
  Object.assign(state, values);
  refresh().catch(fail);
}

function choose(index) {
  if (index < 0 || index >= names.length) return;
  if (index !== state.image && index !== report.reference) state.before = index;
  change({ image: index, peek: null });
}

function toggleReference() {
  if (report.reference === null) return;
  choose(state.image === report.reference ? state.before : report.reference);
}

function setMode(mode) {
  const input = document.querySelector(`input[name=mode][value=${mode}]`);
  if (!input) return;
  input.checked = true;
  change({ mode });
}

function nextMode() {
  const modes = [...document.querySelectorAll("input[name=mode]")].map((input) => input.value);
  setMode(modes[(modes.indexOf(state.mode) + 1) % modes.length]);
}

function toggleSplit() {
  const select = find("split");
  const last = toggleSplit.last ?? [...select.options].at(report.reference === null ? 1 : 1 + report.reference)?.value ?? "";
  if (state.split !== "") toggleSplit.last = state.split;
  select.value = state.split === "" ? last : "";
  change({ split: select.value });
}

function setStops(stops) {
  const slider = find("exposure");
  const clamped = Math.min(Number(slider.max), Math.max(Number(slider.min), Math.round(stops * 20) / 20));
  slider.value = String(clamped);
  if (clamped !== pictures.stops) pictures.setStops(clamped);
  const sign = clamped < 0 ? "−" : "+";
  find("stops").textContent = `${sign}${Math.abs(clamped).toFixed(2)} stops`;
  find("factor").textContent = `× ${Number(pictures.shownExposure.toPrecision(3))}`;
  refresh().catch(fail);
}

function toggleCircles() {
  const box = find("circles");
  if (!box) return;
  box.checked = !box.checked;
  stage.circles = box.checked;
  stage.draw();
}

function zoom(factor) {
  stage.zoomTo(stage.scale * factor);
}

function fail(error) {
  const place = find("failure");
  place.hidden = false;
  place.textContent = `This page cannot be shown: ${error.message}. It may be cut off, or the browser may be too old.`;
}

const KEYS = {
  ArrowRight: () => choose((state.image + 1) % names.length),
  ArrowLeft: () => choose((state.image + names.length - 1) % names.length),
  ArrowUp: () => setStops(pictures.stops + 0.25),
  ArrowDown: () => setStops(pictures.stops - 0.25),
  r: toggleReference,
  e: nextMode,
  s: toggleSplit,
  l: toggleCircles,
  "+": () => zoom(1.5),
  "=": () => zoom(1.5),
  "-": () => zoom(1 / 1.5),
  0: () => stage.reset(),
  "?": () => find("keys").toggleAttribute("open"),
};

function listenToKeys() {
  let since = 0;
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target;
    if (target.matches("select, textarea")) return;
    if (event.key.startsWith("Arrow") && target.matches("input, [role=slider]")) return;
    if (event.key === " ") {
      if (target.matches("button, input, summary, a")) return;
      event.preventDefault();
      if (event.repeat) return;
      since = performance.now();
      toggleReference();
      return;
    }
    const pan = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key];
    if (event.shiftKey && pan) stage.pan(...pan);
    else if (/^[1-9]$/.test(event.key)) choose(Number(event.key) - 1);
    else if (KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key]) {
      KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key]();
    } else return;
    event.preventDefault();
  });
  document.addEventListener("keyup", (event) => {
    if (event.key !== " " || !since) return;
    if (performance.now() - since > 400) toggleReference(); // it was held: back to where it was
    since = 0;
  });
  // After a click the keys belong to the page again, except in lists and on sliders.
  document.addEventListener("click", (event) => {
    const control = event.target.closest("button, input");
    if (control && event.detail > 0 && control.type !== "range") control.blur();
  });
}

function listenToControls() {
  document.querySelectorAll("#images button").forEach((button, index) => {
    button.addEventListener("click", () => choose(index));
    button.addEventListener("pointerenter", (event) => event.pointerType === "mouse" && change({ peek: index }));
    button.addEventListener("pointerleave", () => state.peek !== null && change({ peek: null }));
  });
  document.querySelectorAll("input[name=mode]").forEach((input) =>
    input.addEventListener("change", () => setMode(input.value)),
  );
  document.querySelectorAll("input[name=eyes]").forEach((input) =>
    input.addEventListener("change", () => stage.arrange(input.value.split(" ").map(Number))),
  );
  find("split").addEventListener("change", (event) => change({ split: event.target.value }));
  find("exposure").addEventListener("input", (event) => setStops(Number(event.target.value)));
  find("exposure-reset").addEventListener("click", () => setStops(0));
  find("circles")?.addEventListener("change", (event) => {
    stage.circles = event.target.checked;
    stage.draw();
  });
  find("zoom-in").addEventListener("click", () => zoom(1.5));
  find("zoom-out").addEventListener("click", () => zoom(1 / 1.5));
  find("zoom-reset").addEventListener("click", () => stage.reset());
  find("stage").addEventListener("drawn", () => {
    const percent = stage.scale * (window.devicePixelRatio || 1);
    find("zoom").textContent = `${Number(percent.toPrecision(percent < 10 ? 2 : 3))}×`;
  });
  for (const [id, factor] of [["bar-less", 0.5], ["bar-more", 2]]) {
    find(id).addEventListener("click", () => {
      pictures.rescale(state.mode, factor);
      refresh().catch(fail);
    });
  }
}

// Unpacks the other images while nobody waits, so that flipping is immediate.
async function prefetch() {
  for (let index = 0; index < names.length; index++) {
    await new Promise((resolve) => setTimeout(resolve));
    await pictures.load(index);
    pictures.canvases(index, "image");
  }
  document.body.dataset.loaded = "all";
}

window.addEventListener("error", (event) => fail(event.error ?? event));
listenToKeys();
listenToControls();
prepareTables(document);
setStops(0);
refresh().then(prefetch).catch(fail);
