// Two small charts: innovations of the filter, and how far the graph is behind its source.

import { colours, drawDots, drawEnvelope, extent, prepare, roundUp } from "./canvas.js";
import { milliseconds } from "./format.js";
import { line } from "./traces.js";

const SIGMAS = 5;
const SECONDS = 60;

function chart(canvas, store, name) {
  const drawing = prepare(canvas);
  const found = store.suited(name, SECONDS);
  if (!drawing || !found || !Number.isFinite(store.newest)) return null;
  const begin = store.newest - SECONDS;
  const x = (time) => ((time - begin) / SECONDS) * drawing.width;
  return { ...drawing, ...found, x, first: found.ring.from(begin) };
}

/** Position and velocity innovations over their sigmas, 1 and 3 sigma marked. */
export function drawInnovations(canvas, store) {
  const view = chart(canvas, store, "innovation");
  if (!view) return;
  const { context, width, height, ring } = view;
  const y = (value) => height / 2 - (Math.max(-SIGMAS, Math.min(SIGMAS, value)) / SIGMAS) * (height / 2 - 3);
  const colour = colours();
  context.textAlign = "left";
  for (const sigma of [-3, 0, 3]) {
    context.strokeStyle = colour.line;
    context.setLineDash(sigma ? [4, 4] : []);
    line(context, 0, y(sigma), width, y(sigma));
  }
  context.setLineDash([]);
  ["north", "east", "up"].forEach((axis, k) => {
    context.fillStyle = colour[axis];
    context.globalAlpha = 0.8;
    drawDots(context, ring, k, view.first, view.x, y, 2.2);
    context.globalAlpha = 0.35;
    drawDots(context, ring, k + 3, view.first, view.x, y, 1.6);
  });
  context.globalAlpha = 0.8;
  context.fillStyle = colour.ink;
  drawDots(context, ring, 6, view.first, view.x, y, 2.2);
  context.globalAlpha = 0.35;
  drawDots(context, ring, 7, view.first, view.x, y, 1.6);
  context.globalAlpha = 1;
  context.fillStyle = colour.muted;
  context.fillText("+3", 3, y(3) - 3);
  context.fillText("−3", 3, y(-3) + 11);
}

/** Time from the source's sending a sample to its ground motion. */
export function drawLatency(canvas, store) {
  const view = chart(canvas, store, "latency");
  if (!view) return;
  const { context, width, height, ring, isEnvelope } = view;
  const [, most] = extent(ring, isEnvelope, 0, view.first);
  if (!Number.isFinite(most)) return;
  const scale = roundUp(Math.max(10, most));
  const y = (value) => height - 2 - (value / scale) * (height - 16);
  const colour = colours();
  context.strokeStyle = colour.line;
  line(context, 0, height - 1.5, width, height - 1.5);
  line(context, 0, y(scale) + 0.5, width, y(scale) + 0.5);
  context.fillStyle = colour.muted;
  context.textAlign = "left";
  context.fillText(milliseconds(scale), 3, y(scale) - 3);
  context.strokeStyle = colour.accent;
  context.lineWidth = 1.1;
  drawEnvelope(context, view, 0, view.first, view.x, y, 1 / view.ratio);
}

/** The same in words. */
export function latencyText(store) {
  const found = store.suited("latency", SECONDS);
  if (!found || !Number.isFinite(store.newest)) return "";
  const { ring } = found;
  const values = ring.values.slice(ring.from(store.newest - SECONDS), ring.end).sort();
  if (!values.length) return "";
  return `median ${milliseconds(values[values.length >> 1])}, most ${milliseconds(values.at(-1))}`;
}
