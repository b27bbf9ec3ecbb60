// Canvases at the screen's own resolution, colours of the style sheet, and the drawing of envelopes.

let palette = {};

function readPalette() {
  const style = getComputedStyle(document.documentElement);
  const names = ["ink", "muted", "line", "card", "accent", "warn", "good", "east", "north", "up"];
  palette = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`)]));
}

readPalette();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readPalette);

export const colours = () => palette;

/** Return a canvas' context, cleared, with its size in CSS pixels; null while it is not seen. */
export function prepare(canvas) {
  const { width, height } = canvas.getBoundingClientRect();
  if (!width || !height) return null;
  const ratio = Math.min(3, devicePixelRatio || 1);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "11px system-ui, sans-serif";
  return { context, width, height, ratio };
}

/** Least and greatest value of a column from a row on; NaN where there are none. */
export function extent(ring, isEnvelope, column, first) {
  const { values, columns, end } = ring;
  const high = isEnvelope ? columns / 2 : 0;
  let least = Infinity;
  let most = -Infinity;
  for (let row = first; row < end; row += 1) {
    const at = row * columns + column;
    if (values[at] < least) least = values[at];
    if (values[at + high] > most) most = values[at + high];
  }
  return least <= most ? [least, most] : [NaN, NaN];
}

/**
 * Draw a column: for every pixel the least and greatest value in it, so that no peak is lost.
 * `x` and `y` turn times and values into pixels; a gap in time breaks the line.
 */
export function drawEnvelope(context, { ring, isEnvelope }, column, first, x, y, pixel) {
  const { times, values, columns, end } = ring;
  const high = isEnvelope ? columns / 2 : 0;
  const gap = isEnvelope ? Infinity : 3.5 * ring.interval;
  let at = NaN;
  let [least, most, last] = [Infinity, -Infinity, NaN];
  let [joined, before] = [false, -Infinity];
  const flush = () => {
    if (!(least <= most)) return;
    if (joined) context.lineTo(at, y(least));
    else context.moveTo(at, y(least));
    if (most > least) {
      context.lineTo(at, y(most));
      context.lineTo(at, y(last));
    }
    joined = true;
  };
  context.beginPath();
  for (let row = first; row < end; row += 1) {
    const low = values[row * columns + column];
    const top = values[row * columns + column + high];
    const place = Math.round(x(times[row]) / pixel) * pixel;
    const torn = times[row] - before > gap || low !== low;
    before = times[row];
    if (place !== at || torn) {
      flush();
      if (torn) joined = false;
      at = place;
      [least, most] = [Infinity, -Infinity];
    }
    if (low < least) least = low;
    if (top > most) most = top;
    last = isEnvelope ? (low + top) / 2 : low;
  }
  flush();
  context.stroke();
}

/** Draw a column's samples as dots. */
export function drawDots(context, ring, column, first, x, y, size) {
  const { times, values, columns, end } = ring;
  for (let row = first; row < end; row += 1) {
    const value = values[row * columns + column];
    if (value === value) context.fillRect(x(times[row]) - size / 2, y(value) - size / 2, size, size);
  }
}

/** Next round number at or above a size. */
export function roundUp(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return power * [1, 1.5, 2, 3, 4, 5, 6, 8, 10].find((step) => step * power >= size * (1 - 1e-9));
}
