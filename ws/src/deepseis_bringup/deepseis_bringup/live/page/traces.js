// The seismogram: acceleration, velocity, displacement, each east, north, up on one scale.

import { colours, drawDots, drawEnvelope, extent, prepare, roundUp } from "./canvas.js";
import { clock, digits, unitOf } from "./format.js";

const AXES = [["E", "east"], ["N", "north"], ["U", "up"]];
const FOOT = 15;
const SHRINK_MS = 3000;
const LEAST = { acceleration: 0.02, velocity: 2e-3, displacement: 2e-3 };

/** Steps of time [s], the coarsest that gives at least four marks. */
const STEPS = [2, 5, 10, 60, 120, 300, 600];

/** One quantity on one canvas. */
export class Lanes {
  constructor(canvas, quantity, column) {
    Object.assign(this, { canvas, quantity, column, scale: LEAST[quantity], smallSince: 0 });
  }

  draw(store, seconds, events) {
    const drawing = prepare(this.canvas);
    if (!drawing || !Number.isFinite(store.newest)) return;
    const { context, width, height } = drawing;
    const end = store.newest;
    const view = { ...drawing, begin: end - seconds, seconds, lane: (height - FOOT) / 3 };
    view.x = (time) => ((time - view.begin) / seconds) * width;
    this.drawEvents(context, view, store, events);
    this.drawTimes(context, view, store);
    const motion = store.suited("motion", seconds);
    const gnss = this.quantity === "displacement" ? store.suited("gnss", seconds) : null;
    const main = motion ?? gnss;
    if (!main) return;
    const column = motion ? this.column : 0;
    const first = main.ring.from(view.begin);
    const extents = AXES.map((_, k) => extent(main.ring, main.isEnvelope, column + k, first));
    const middles = extents.map((found) => this.middle(found));
    this.rescale(extents, middles);
    AXES.forEach(([name, axis], k) => {
      const lane = { top: k * view.lane, middle: middles[k], extent: extents[k], name, axis };
      this.drawLane(context, view, lane, main, column + k, gnss !== main ? gnss : null, k, first);
    });
  }

  /** Where a lane's line is drawn through: displacement may stay away from zero. */
  middle([least, most]) {
    if (this.quantity !== "displacement" || !Number.isFinite(least)) return 0;
    const [half, centre] = [(most - least) / 2, (most + least) / 2];
    const step = roundUp(Math.max(half, LEAST.displacement / 2));
    return Math.abs(centre) < half + step ? 0 : Math.round(centre / step) * step;
  }

  /** Grow at once, shrink when all has been small for a while. */
  rescale(extents, middles) {
    const sizes = extents.flatMap((pair, k) => pair.map((value) => Math.abs(value - middles[k])));
    const size = Math.max(...sizes.filter(Number.isFinite), LEAST[this.quantity] * 0.9);
    const wanted = roundUp(size * 1.05);
    const now = performance.now();
    if (wanted >= this.scale) this.smallSince = now;
    if (wanted > this.scale || now - this.smallSince > SHRINK_MS) this.scale = wanted;
  }

  drawLane(context, view, lane, main, column, gnss, k, first) {
    const { width } = view;
    const centre = lane.top + view.lane / 2;
    const y = (value) => centre - ((value - lane.middle) / this.scale) * (view.lane / 2 - 3);
    const colour = colours();
    context.strokeStyle = colour.line;
    context.lineWidth = 1;
    line(context, 0, Math.round(centre) + 0.5, width, Math.round(centre) + 0.5);
    context.save();
    context.beginPath();
    context.rect(0, lane.top, width, view.lane);
    context.clip();
    if (gnss) this.drawAlone(context, view, gnss, k, y);
    context.strokeStyle = colour[lane.axis];
    context.lineWidth = 1.15;
    context.lineJoin = "round";
    drawEnvelope(context, main, column, Math.max(first - 1, main.ring.begin), view.x, y, 1 / view.ratio);
    context.restore();
    this.label(context, view, lane);
  }

  /** Displacement from GNSS alone, behind the fused one: dots, where there is room for them. */
  drawAlone(context, view, gnss, k, y) {
    const first = gnss.ring.from(view.begin);
    context.globalAlpha = 0.55;
    if (!gnss.isEnvelope && (gnss.ring.end - first) * 1.5 < view.width) {
      context.fillStyle = colours().muted;
      drawDots(context, gnss.ring, k, first, view.x, y, 2);
    } else {
      context.strokeStyle = colours().muted;
      context.lineWidth = 1;
      drawEnvelope(context, gnss, k, first, view.x, y, 1);
    }
    context.globalAlpha = 1;
  }

  label(context, view, lane) {
    const { factor, unit } = unitOf(this.quantity, this.scale);
    const [least, most] = lane.extent;
    const peak = Math.abs(least) > Math.abs(most) ? least : most;
    const colour = colours();
    const top = lane.top + 12;
    context.textAlign = "left";
    tag(context, lane.name, 4, top, colour[lane.axis], "bold 12px system-ui, sans-serif");
    if (!Number.isFinite(peak)) return;
    const text = `${digits(peak * factor)} ${unit}`;
    tag(context, text, 20, top, colour.muted, "11px system-ui, sans-serif");
    context.textAlign = "right";
    const middle = lane.middle ? `${digits(lane.middle * factor)} ` : "";
    const range = `${middle}±${digits(this.scale * factor, 2)} ${unit}`;
    if (lane.name === "E" || lane.middle) {
      tag(context, range, view.width - 4, top, colour.muted, "11px system-ui, sans-serif");
    }
  }

  drawTimes(context, view, store) {
    const { width, height, begin, seconds } = view;
    const step = STEPS.findLast((value) => seconds / value >= 4) ?? STEPS[0];
    const origin = store.originMs / 1000;
    const colour = colours();
    context.textAlign = "center";
    const room = width / (seconds / step);
    const every = Math.ceil(62 / room);
    for (let n = Math.ceil((begin + origin) / step); n * step <= begin + origin + seconds; n += 1) {
      const x = Math.round(view.x(n * step - origin)) + 0.5;
      context.strokeStyle = colour.line;
      context.lineWidth = 1;
      line(context, x, 0, x, height - FOOT);
      if (n % every || x < 26 || x > width - 26) continue;
      context.fillStyle = colour.muted;
      context.font = "11px system-ui, sans-serif";
      context.fillText(clock(n * step * 1000), x, height - 3);
    }
  }

  drawEvents(context, view, store, events) {
    const { height, width } = view;
    for (const event of events) {
      const from = view.x((event.onset_ms - store.originMs) / 1000);
      const to = event.ended ? view.x((event.report_ms - store.originMs) / 1000) : width;
      if (to < 0 || from > width) continue;
      context.fillStyle = colours().warn;
      context.globalAlpha = 0.06;
      context.fillRect(from, 0, to - from, height - FOOT);
      context.globalAlpha = 1;
      context.fillRect(Math.round(from) - 0.5, 0, 1.5, height - FOOT);
      if (from < 0) continue;
      context.textAlign = from > width - 60 ? "right" : "left";
      context.font = "11px system-ui, sans-serif";
      context.fillText("onset", from + (from > width - 60 ? -4 : 4), height - FOOT - 4);
    }
  }
}

export function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

/** Text on a bit of the card's colour, so that the trace does not run through it. */
function tag(context, text, x, y, colour, font) {
  context.font = font;
  const width = context.measureText(text).width;
  const left = context.textAlign === "right" ? x - width : x;
  context.globalAlpha = 0.75;
  context.fillStyle = colours().card;
  context.fillRect(left - 2, y - 10, width + 4, 13);
  context.globalAlpha = 1;
  context.fillStyle = colour;
  context.fillText(text, x, y);
}
