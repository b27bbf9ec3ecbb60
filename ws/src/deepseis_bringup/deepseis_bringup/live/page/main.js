// The live page: listens to the station, draws what comes, says what it has shown.

import { drawInnovations, drawLatency, latencyText } from "./charts.js";
import { clock, put, span } from "./format.js";
import * as panels from "./panels.js";
import { Sky } from "./sky.js";
import { Store } from "./store.js";
import { Lanes } from "./traces.js";

const store = new Store();
const sky = new Sky(document.getElementById("skyplot"));
const lanes = [["acceleration", 0], ["velocity", 3], ["displacement", 6]].map(
  ([quantity, column]) => new Lanes(document.getElementById(quantity), quantity, column),
);
const view = { seconds: 60, state: null, frame: 0, page: "", drawn: 0, dirty: false };
const link = { socket: null, failures: 0, lostAt: Date.now(), first: true };

/** Told to tests, and to whoever looks with the browser's tools. */
globalThis.deepseis = { view, link, store };

function connect() {
  const address = new URL("live", location.href);
  address.protocol = address.protocol.replace("http", "ws");
  const socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  Object.assign(link, { socket, first: true });
  socket.addEventListener("message", (message) => take(socket, message.data));
  socket.addEventListener("close", () => lose(socket));
}

function take(socket, data) {
  const header = store.take(data, link.first);
  Object.assign(link, { first: false, failures: 0, lostAt: 0 });
  view.frame = header.frame;
  view.dirty = true;
  if (header.state) {
    view.state = header.state;
    if (view.page && view.page !== header.state.page) location.reload();
    view.page = header.state.page;
  }
  if (document.hidden) socket.send(`r${header.frame}`);
  else schedule();
}

/** Try again, soon at first; a station that wants a token now has to be asked for the form. */
async function lose(socket) {
  if (socket !== link.socket) return;
  link.lostAt ||= Date.now();
  link.failures += 1;
  showLink();
  if (link.failures % 3 === 0) {
    const answer = await fetch("state").catch(() => null);
    if (answer?.status === 401) location.reload();
  }
  setTimeout(connect, Math.min(5000, 250 * 2 ** Math.min(link.failures, 5)));
}

let scheduled = false;

function schedule() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(() => {
    scheduled = false;
    draw();
  });
}

function draw() {
  const events = view.state?.events ?? [];
  for (const lane of lanes) lane.draw(store, view.seconds, events);
  drawInnovations(document.getElementById("innovation"), store);
  drawLatency(document.getElementById("latency"), store);
  if (view.state) showState(view.state);
  view.drawn += 1;
  view.dirty = false;
  if (link.socket?.readyState === WebSocket.OPEN && view.frame) link.socket.send(`s${view.frame}`);
}

let shown = null;

function showState(state) {
  if (state === shown) return;
  shown = state;
  panels.showHeader(state);
  panels.showEvent(state);
  panels.showSigmas(state);
  panels.showSatellites(state);
  panels.showFilter(state);
  panels.showStillness(state);
  panels.showDiagnostics(state);
  panels.showSilence(state);
  sky.update(state.satellites);
  put(document.getElementById("behind"), latencyText(store));
  showLink();
  const running = state.events.at(-1)?.ended === false;
  document.title = `${running ? "● event · " : ""}${state.station.name || "DeepSeis"}`;
}

function showLink() {
  const state = view.state;
  if (link.lostAt) {
    panels.showLink("no connection", "bad");
    const since = `No connection since ${clock(link.lostAt)} UTC by this machine's clock`;
    const ended = state?.ended ? " The run had ended; this is its last picture." : "";
    panels.showBanner(`${since}; trying again.${ended}`);
    return;
  }
  const silent = state?.silent_s.source;
  if (state?.ended) {
    panels.showLink("ended", "");
    panels.showBanner("The run has ended; this is its last picture.");
  } else if (silent === undefined) {
    panels.showLink("connected", "");
    panels.showBanner("Waiting for the source's first samples.");
  } else if (silent > 3) {
    panels.showLink("no samples", "bad");
    panels.showBanner(`The source has said nothing for ${span(silent)}.`);
  } else {
    panels.showLink("live", "good");
    panels.showBanner("");
  }
}

for (const button of document.querySelectorAll(".windows button")) {
  button.addEventListener("click", () => {
    view.seconds = Number(button.dataset.seconds);
    for (const other of document.querySelectorAll(".windows button")) {
      other.setAttribute("aria-pressed", String(other === button));
    }
    schedule();
  });
}
document.addEventListener("visibilitychange", () => document.hidden || schedule());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", schedule);
new ResizeObserver(schedule).observe(document.body);
setInterval(() => link.lostAt && showLink(), 1000);
connect();
