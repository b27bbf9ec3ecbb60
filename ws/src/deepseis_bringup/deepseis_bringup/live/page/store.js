// What the page keeps of the traces: rings of the size that the server keeps too.

/** The newest rows; they lie in a buffer of twice the room, always in one piece. */
export class Ring {
  constructor(room, columns, interval) {
    Object.assign(this, { room, columns, interval, begin: 0, end: 0 });
    this.times = new Float64Array(2 * room);
    this.values = new Float32Array(2 * room * columns);
  }

  push(times, values) {
    const n = times.length;
    if (this.end + n > this.times.length) {
      const kept = Math.max(this.begin, this.end - this.room);
      this.times.copyWithin(0, kept, this.end);
      this.values.copyWithin(0, kept * this.columns, this.end * this.columns);
      this.end -= kept;
      this.begin = 0;
    }
    this.times.set(times, this.end);
    this.values.set(values, this.end * this.columns);
    this.end += n;
    this.begin = Math.max(this.begin, this.end - this.room);
  }

  get newest() {
    return this.end > this.begin ? this.times[this.end - 1] : -Infinity;
  }

  /** First row at or after a time. */
  from(time) {
    let low = this.begin;
    let high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

/** All traces, by name: a ring for each level. */
export class Store {
  constructor() {
    this.traces = new Map();
    this.originMs = 0;
    this.bytes = 0;
  }

  /** Take a frame; returns its header. The first of a connection brings everything anew. */
  take(buffer, first) {
    const length = new DataView(buffer).getUint32(0, true);
    const text = new TextDecoder().decode(new Uint8Array(buffer, 4, length));
    const header = JSON.parse(text);
    if (first) this.traces.clear();
    this.originMs = header.origin_ms;
    let at = 4 + length;
    for (const block of header.blocks) {
      const times = new Float64Array(buffer, at, block.count);
      at += 8 * block.count;
      const values = new Float32Array(buffer, at, block.count * block.columns);
      at += 8 * Math.ceil((block.count * block.columns) / 2);
      this.ring(block).push(times, values);
    }
    this.bytes += buffer.byteLength;
    return header;
  }

  ring(block) {
    if (!this.traces.has(block.trace)) this.traces.set(block.trace, []);
    const rings = this.traces.get(block.trace);
    if (block.fresh || !rings[block.level]) {
      rings[block.level] = new Ring(block.room, block.columns, block.interval);
    }
    return rings[block.level];
  }

  /** The ring of a trace that suits a length of time: samples, or envelopes. */
  suited(name, seconds) {
    const rings = this.traces.get(name);
    if (!rings) return null;
    const level = seconds <= 60 ? 0 : seconds <= 600 ? 1 : 2;
    return rings[level] ? { ring: rings[level], isEnvelope: level > 0 } : null;
  }

  /** Time of the newest ground motion [s]. */
  get newest() {
    const of = (name) => this.traces.get(name)?.[0]?.newest ?? -Infinity;
    return Math.max(of("motion"), of("gnss"));
  }
}
