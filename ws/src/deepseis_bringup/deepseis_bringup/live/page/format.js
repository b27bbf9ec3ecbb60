// Numbers, units and times as the page writes them.

export const NONE = "–";

/** Round to three significant digits, without an exponent. */
export function digits(value, count = 3) {
  if (!Number.isFinite(value)) return NONE;
  if (value === 0) return "0";
  const places = count - 1 - Math.floor(Math.log10(Math.abs(value)));
  return fixed(value, Math.min(6, Math.max(0, places)));
}

/** Write a value with so many decimals, and a true minus. */
export function fixed(value, decimals) {
  if (value === null || value === undefined) return NONE;
  return value.toFixed(decimals).replace("-", "\u2212");
}

/** Units of a quantity, by the size from which each is used. */
const UNITS = {
  acceleration: [[0, 1e3, "mm/s²"], [0.1, 1, "m/s²"]],
  velocity: [[0, 1e3, "mm/s"], [0.02, 100, "cm/s"], [2, 1, "m/s"]],
  displacement: [[0, 1e3, "mm"], [0.02, 100, "cm"], [2, 1, "m"]],
};

/** Return factor and unit for values up to a size. */
export function unitOf(quantity, size) {
  const [, factor, unit] = UNITS[quantity].findLast(([from]) => size >= from);
  return { factor, unit };
}

/** Write a value with the unit that suits it. */
export function withUnit(quantity, value, size = Math.abs(value)) {
  if (value === null || !Number.isFinite(value)) return [NONE, ""];
  const { factor, unit } = unitOf(quantity, size);
  return [digits(value * factor), unit];
}

/** Write a time that is given in milliseconds. */
export function milliseconds(value) {
  return value < 1000 ? `${digits(value, 2)} ms` : `${digits(value / 1000, 2)} s`;
}

const two = (number) => String(number).padStart(2, "0");

/** Time of day, UTC; `tenths` for tenths of seconds. */
export function clock(ms, tenths = false) {
  const at = new Date(ms);
  const text = `${two(at.getUTCHours())}:${two(at.getUTCMinutes())}:${two(at.getUTCSeconds())}`;
  return tenths ? `${text}.${Math.floor(at.getUTCMilliseconds() / 100)}` : text;
}

/** Date, UTC. */
export function day(ms) {
  return new Date(ms).toISOString().slice(0, 10);
}

/** A span of time in words. */
export function span(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${two(whole % 60)} s`;
  return `${Math.floor(whole / 3600)} h ${two(Math.floor((whole % 3600) / 60))} min`;
}

/** Set an element's text if it is another. */
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A value in large figures with a small unit behind. */
export function putValue(element, [value, unit], more = "") {
  const key = `${value}|${unit}|${more}`;
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.replaceChildren(value);
  for (const [name, text] of [["i", unit], ["small", more]]) {
    if (!text) continue;
    const part = document.createElement(name);
    part.textContent = text;
    element.append(part);
  }
}
