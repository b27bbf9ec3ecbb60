// The sky above the station: north up, horizon outside.

const SVG = "http://www.w3.org/2000/svg";
const RADIUS = 96;

function make(name, attributes, text = "") {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.textContent = text;
  return element;
}

/** How a satellite is marked: by its loop, and whether the position uses it. */
export function kindOf(row) {
  if (!row.phase_lock) return "seeking";
  return row.aided ? "aided" : "own";
}

export class Sky {
  constructor(svg) {
    this.marks = new Map();
    for (const elevation of [0, 30, 60]) {
      svg.append(make("circle", { r: (RADIUS * (90 - elevation)) / 90, class: "ring" }));
      if (elevation) svg.append(make("text", { x: 2, y: -(RADIUS * (90 - elevation)) / 90 + 8, class: "grade" }, `${elevation}°`));
    }
    svg.append(make("path", { d: `M0-${RADIUS}V${RADIUS}M-${RADIUS} 0H${RADIUS}`, class: "ring" }));
    const names = { N: [0, -101], E: [104, 3], S: [0, 108], W: [-104, 3] };
    for (const [name, [x, y]] of Object.entries(names)) {
      svg.append(make("text", { x, y, class: "wind" }, name));
    }
    this.layer = svg.appendChild(make("g", {}));
  }

  update(rows) {
    const seen = new Set();
    for (const row of rows) {
      if (row.azimuth_deg === null) continue;
      seen.add(row.name);
      if (!this.marks.has(row.name)) this.marks.set(row.name, this.create(row.name));
      this.place(this.marks.get(row.name), row);
    }
    for (const [name, mark] of this.marks) {
      if (seen.has(name)) continue;
      mark.remove();
      this.marks.delete(name);
    }
  }

  create(name) {
    const mark = make("g", {});
    mark.append(make("title", {}), make("circle", {}), make("text", {}, name.slice(1)));
    return this.layer.appendChild(mark);
  }

  place(mark, row) {
    const distance = (RADIUS * (90 - row.elevation_deg)) / 90;
    const angle = (row.azimuth_deg * Math.PI) / 180;
    const [x, y] = [distance * Math.sin(angle), -distance * Math.cos(angle)];
    mark.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
    mark.setAttribute("class", `sat ${kindOf(row)}${row.used ? "" : " unused"}`);
    const [title, circle, text] = mark.children;
    circle.setAttribute("r", 8.5);
    text.setAttribute("y", 3);
    title.textContent = `${row.name}: ${row.cn0_dbhz ?? "–"} dB-Hz, ${row.mode}`;
  }
}
