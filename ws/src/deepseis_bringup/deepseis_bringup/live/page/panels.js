// Everything that is not a picture: header, event, satellites, filter, motion state, diagnostics.

import { NONE, clock, day, digits, fixed, milliseconds, put, putValue, span, withUnit } from "./format.js";
import { kindOf } from "./sky.js";

const $ = (id) => document.getElementById(id);
const SILENT_S = 3;
const G = 9.80665;

function row(cells) {
  const tr = document.createElement("tr");
  for (let k = 0; k < cells; k += 1) tr.append(document.createElement(k ? "td" : "th"));
  return tr;
}

/** Let a parent have one child for each key, in order; returns them. */
function keyed(parent, keys, create) {
  const old = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  const children = keys.map((key) => {
    const child = old.get(key) ?? create();
    child.dataset.key = key;
    old.delete(key);
    return child;
  });
  for (const child of old.values()) child.remove();
  children.forEach((child, k) => {
    if (parent.children[k] !== child) parent.insertBefore(child, parent.children[k] ?? null);
  });
  return children;
}

function pill(id, kind, text, more = "") {
  const element = $(id);
  element.className = `pill ${kind}`;
  put(element.firstElementChild, text);
  put(element.lastElementChild, more);
}

export function showHeader(state) {
  const { station, pvt, motion, utc_ms: utc } = state;
  put($("station"), station.name ? [station.network, station.name].filter(Boolean).join(".") : "DeepSeis");
  const place = station.latitude_deg === undefined ? pvt : station;
  const where = place.latitude_deg === undefined ? "" : position(place);
  put($("place"), [where, station.imu].filter(Boolean).join(" · "));
  if (utc > 0) {
    put($("utc"), clock(utc));
    put($("date"), `${day(utc)} UTC`);
  }
  const kinds = { static: ["good", "still"], moving: ["bad", "moving"], unknown: ["", "unknown"] };
  const [kind, word] = motion.state ? kinds[motion.state] : ["", "no IMU"];
  const since = motion.state ? `for ${span((utc - motion.since_ms) / 1000)}` : "motion unknown";
  pill("motion", kind, word, since);
  const fixed = pvt.status && pvt.status !== "none";
  const used = pvt.used === undefined ? "" : `${pvt.used} satellites, PDOP ${pvt.pdop ?? NONE}`;
  pill("fix", fixed ? "good" : "", fixed ? `${pvt.status} fix` : "no fix", used || "no position yet");
  const shown = state.shown;
  pill("delay", "", shown ? milliseconds(shown.median_ms) : NONE, "sample to screen");
}

function position({ latitude_deg: latitude, longitude_deg: longitude, height_m: height }) {
  const ns = latitude < 0 ? "S" : "N";
  const ew = longitude < 0 ? "W" : "E";
  return `${Math.abs(latitude).toFixed(5)}° ${ns}  ${Math.abs(longitude).toFixed(5)}° ${ew}  ${height.toFixed(0)} m`;
}

export function showLink(text, kind) {
  pill("link", kind, text, "this page");
}

export function showBanner(text) {
  $("banner").hidden = !text;
  put($("banner"), text);
}

/** Mark what has not been heard of for a while. */
export function showSilence(state) {
  for (const tag of document.querySelectorAll(".tag")) {
    const silent = state.silent_s[tag.dataset.group];
    const stale = !state.ended && silent !== undefined && silent > SILENT_S;
    put(tag, stale ? `silent for ${span(silent)}` : "");
    tag.closest("section").classList.toggle("stale", stale);
  }
}

export function showEvent(state) {
  const event = state.events.at(-1);
  const running = Boolean(event) && !event.ended;
  $("event").className = running ? "running" : "";
  if (!event) return;
  put($("event-title"), running ? "Event in progress" : "Last event");
  const ratio = event.onset_ratio === null ? "" : `, STA/LTA ${event.onset_ratio}`;
  const length = span((event.report_ms - event.onset_ms) / 1000);
  const others = state.events.length > 1 ? `, ${state.events.length} since this page's start` : "";
  put($("event-text"), `${running ? "for" : "lasted"} ${length}${ratio}${others}`);
  putValue($("pga"), withUnit("acceleration", event.pga), `${digits(event.pga / G, 2)} g`);
  putValue($("pgv"), withUnit("velocity", event.pgv));
  putValue($("pgd"), withUnit("displacement", event.pgd));
  const sd = event.magnitude_sd === null ? "" : `± ${event.magnitude_sd}`;
  putValue($("magnitude"), [event.magnitude === null ? NONE : event.magnitude.toFixed(1), ""],
    event.magnitude === null ? "no epicentre" : sd);
  const onset = day(event.onset_ms);
  putValue($("onset"), [clock(event.onset_ms, true), ""], onset === day(state.utc_ms) ? "" : onset);
}

export function showSigmas({ sigmas }) {
  for (const [name, quantity] of [["a", "acceleration"], ["v", "velocity"], ["d", "displacement"]]) {
    const sd = sigmas[`${quantity}_sd`];
    if (!sd) continue;
    const size = Math.max(...sd);
    const parts = sd.map((value) => withUnit(quantity, value, size)[0]);
    put($(`sd-${name}`), `1σ ${parts.join(" / ")} ${withUnit(quantity, size)[1]}`);
  }
}

export function showSatellites({ satellites }) {
  const body = document.querySelector("#satellites tbody");
  const rows = [...satellites].sort((a, b) => (b.elevation_deg ?? -1) - (a.elevation_deg ?? -1));
  const elements = keyed(body, rows.map((item) => item.name), () => {
    const tr = row(8);
    const bar = document.createElement("i");
    tr.children[1].append(bar, document.createElement("span"));
    return tr;
  });
  rows.forEach((item, k) => satellite(elements[k], item));
}

function satellite(tr, item) {
  tr.className = `${kindOf(item)}${item.used ? "" : " unused"}${item.silent_s > SILENT_S ? " old" : ""}`;
  const [name, cn0, loop, age, lock, elevation, residual, slips] = tr.children;
  put(name, item.name);
  const level = Math.max(0, Math.min(1, ((item.cn0_dbhz ?? 0) - 15) / 40));
  cn0.firstElementChild.style.setProperty("--level", level.toFixed(3));
  put(cn0.lastElementChild, item.cn0_dbhz?.toFixed(1) ?? NONE);
  const trouble = item.aid_diverged ? ", dropped" : item.aid_missed ? ", late" : "";
  put(loop, item.mode + trouble);
  put(lock, item.phase_lock ? item.phase_lock_indicator?.toFixed(2) ?? NONE : item.code_lock ? "code" : "none");
  put(age, item.aid_age_ms === null || item.aid_age_ms === undefined ? NONE : item.aid_age_ms.toFixed(0));
  put(elevation, fixed(item.elevation_deg, 0));
  put(residual, item.rejected ? "out" : fixed(item.residual_m, 1));
  put(slips, String(item.slips));
}

const SIGMAS = [
  ["Position", "position_sd", 1e3, "mm"],
  ["Velocity", "velocity_sd", 1e3, "mm/s"],
  ["Attitude", "attitude_sd", 1, "deg"],
  ["Gyro bias", "gyro_sd", 1, "deg/h"],
  ["Accelerometer bias", "accelerometer_sd", 1, "µg"],
];
const BIASES = [
  ["Gyro bias, F L U", "gyro_bias_deg_h", 1, "deg/h"],
  ["Accel. bias, F L U", "accelerometer_bias_ug", 1, "µg"],
];

export function showFilter({ filter }) {
  const body = document.querySelector("#filter tbody");
  const lines = [...SIGMAS, ...BIASES].filter(([, key]) => filter[key]);
  const elements = keyed(body, lines.map(([, key]) => key), () => row(5));
  lines.forEach(([name, key, factor, unit], k) => {
    const cells = elements[k].children;
    put(cells[0], name);
    filter[key].forEach((value, n) => put(cells[n + 1], value === null ? NONE : digits(value * factor)));
    put(cells[4], unit);
  });
  put($("filter-name"), filter.name ? `${filter.name} coupling` : "not running");
  if (filter.accepted === undefined) return;
  const total = filter.accepted + filter.rejected;
  put($("gate"), total ? `${filter.rejected} of ${total} refused` : "");
}

const METERS = ["gyro x", "gyro y", "gyro z", "accel. x", "accel. y", "accel. z"];

export function showStillness({ motion }) {
  put($("policy"), motion.policy ?? "");
  const parent = document.querySelector("#stillness .meters");
  const names = motion.ratio ? METERS : [];
  const elements = keyed(parent, names, () => {
    const meter = document.createElement("p");
    meter.append(document.createElement("span"), document.createElement("i"), document.createElement("b"));
    return meter;
  });
  elements.forEach((meter, k) => {
    const ratio = motion.ratio[k];
    put(meter.children[0], METERS[k]);
    meter.className = ratio > 1 ? "over" : "";
    meter.children[1].style.setProperty("--level", Math.min(1, (ratio ?? 0) / 2).toFixed(3));
    put(meter.children[2], ratio === null ? NONE : digits(ratio, 2));
  });
}

const LEVELS = ["good", "warn", "bad", "bad"];

export function showDiagnostics({ diagnostics }) {
  const parent = document.querySelector("#diagnostics .list");
  const items = [...diagnostics].sort((a, b) => b.level - a.level || (a.name < b.name ? -1 : 1));
  const elements = keyed(parent, items.map((item) => item.name), () => {
    const details = document.createElement("details");
    const summary = document.createElement("summary");
    for (const name of ["i", "b", "span", "small"]) summary.append(document.createElement(name));
    details.append(summary, document.createElement("p"));
    return details;
  });
  items.forEach((item, k) => diagnostic(elements[k], item));
  const bad = items.filter((item) => item.level > 0).length;
  put($("levels"), items.length ? (bad ? `${bad} of ${items.length} not well` : "all well") : "nothing said yet");
}

function diagnostic(element, item) {
  element.className = LEVELS[item.level] ?? "bad";
  const [, name, text, age] = element.firstElementChild.children;
  put(name, item.name);
  put(text, item.text);
  put(age, item.silent_s > SILENT_S ? span(item.silent_s) : "");
  if (!element.open) return;
  const pairs = Object.entries(item.values).map(([key, value]) => `${key} ${value}`);
  put(element.lastElementChild, pairs.join(" · ") || "no values");
}
