// Bands over time: who drives and why, what the judge advises, and what happened.

const WINDOW_S = 60;
const KINDS = {
  veto: ["▲", "--warn"],
  takeover: ["●", "--policy"],
  contact: ["✖", "--bad"],
  late: ["◆", "--scan"],
  fault: ["■", "--bad"],
  swap: ["◇", "--quiet"],
  episode: ["│", "--quiet"],
};

// Reasons that are marked below the band: someone else drives than was advised.
const MARKED = {
  vetoed: "--warn", unsafe: "--warn", takeover: "--ink", faulty: "--bad", blocked: "--bad",
  unplanned: "--bad", blind: "--bad", late: "--bad", contested: "--bad", expired: "--quiet",
};

export const kinds = KINDS;

export class Timeline {
  constructor(canvas, store) {
    this.canvas = canvas;
    this.store = store;
    this.context = canvas.getContext("2d");
    this.hover = null;
    let isDown = false;
    const seek = (event) => {
      const seconds = this.secondsAt(event.offsetX);
      const sample = store.samples[store.indexOfTime(seconds)];
      if (!sample) return;
      store.isPlaying = false;
      store.seek(this.tickAt(seconds));
    };
    canvas.addEventListener("pointerdown", (event) => {
      isDown = true;
      canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    canvas.addEventListener("pointerup", () => (isDown = false));
    canvas.addEventListener("pointercancel", () => (isDown = false));
    canvas.addEventListener("pointermove", (event) => {
      this.hover = event.offsetX;
      if (isDown) seek(event);
      store.tell("draw");
    });
    canvas.addEventListener("pointerleave", () => {
      this.hover = null;
      store.tell("draw");
    });
  }

  // The seconds that are shown: of a recording all of them, of a run the last minute.
  range() {
    const { samples } = this.store;
    if (!samples.length) return [0, 1];
    const [first, last] = [samples[0].taken_s, samples.at(-1).taken_s];
    if (this.store.isRecording) return [first, Math.max(last, first + 1)];
    return [Math.max(first, last - WINDOW_S), Math.max(last, first + 5)];
  }

  secondsAt(x) {
    const [from, to] = this.range();
    return from + (x / this.canvas.clientWidth) * (to - from);
  }

  // Between two samples the ticks are even.
  tickAt(seconds) {
    const { samples } = this.store;
    const index = Math.max(0, this.store.indexOfTime(seconds));
    const [a, b] = [samples[index], samples[index + 1]];
    if (!b || b.taken_s <= a.taken_s) return a.tick;
    return a.tick + ((seconds - a.taken_s) / (b.taken_s - a.taken_s)) * (b.tick - a.tick);
  }

  secondsOf(tick) {
    const { samples } = this.store;
    const index = this.store.indexAt(tick);
    const [a, b] = [samples[Math.max(0, index)], samples[index + 1]];
    if (!a) return 0;
    if (index < 0 || !b || b.tick <= a.tick) return a.taken_s;
    return a.taken_s + ((tick - a.tick) / (b.tick - a.tick)) * (b.taken_s - a.taken_s);
  }

  restyle() {
    const style = getComputedStyle(document.documentElement);
    this.color = (name) => style.getPropertyValue(name).trim();
  }

  draw() {
    const { canvas, context, store } = this;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!store.samples.length || !store.hello) return;
    const [from, to] = this.range();
    const x = (seconds) => ((seconds - from) / (to - from)) * width;
    this.drawDrivers(x, width);
    this.drawAdvice(x, width);
    this.drawEvents(x, width);
    this.drawScale(x, [from, to], [width, height]);
    const at = x(this.secondsOf(store.shownTick));
    context.fillStyle = this.color("--ink");
    context.fillRect(Math.min(width - 2, at - 1), 0, 2, 58);
    if (this.hover !== null) this.drawHover(width);
  }

  // Runs of one driver and reason: from, to, driver, reason.
  runs() {
    const { samples } = this.store;
    const runs = [];
    for (const sample of samples) {
      for (const [tick, driver, reason] of sample.drivers) {
        const seconds = sample.drivers.length === 1 && sample.steps <= 2 ? sample.taken_s : this.secondsOf(tick);
        if (runs.length) runs.at(-1).to = seconds;
        runs.push({ from: seconds, to: seconds, driver, reason });
      }
    }
    if (runs.length) runs.at(-1).to = samples.at(-1).taken_s;
    // What came before the first change in sight had the driver of then.
    if (runs.length && this.earlier && samples[0].taken_s < runs[0].from) {
      runs.unshift({ from: samples[0].taken_s, to: runs[0].from, ...this.earlier });
    } else if (!runs.length && this.earlier) {
      runs.push({ from: samples[0].taken_s, to: samples.at(-1).taken_s, ...this.earlier });
    }
    return runs;
  }

  // Samples leave the window: the driver of the last one that left is remembered.
  remember(dropped) {
    for (const sample of dropped) {
      const last = sample.drivers.at(-1);
      if (last) this.earlier = { driver: last[1], reason: last[2] };
    }
  }

  drawDrivers(x, width) {
    const { context, store } = this;
    context.font = "600 11px system-ui, sans-serif";
    context.textBaseline = "middle";
    this.drawn = this.runs();
    for (const run of this.drawn) {
      const [left, right] = [Math.max(0, x(run.from)), Math.min(width, x(run.to))];
      if (right < 0 || left > width) continue;
      const [word] = store.hello.drivers[run.driver] ?? ["unknown"];
      context.fillStyle = this.color(`--${word}`);
      context.fillRect(left, 2, Math.max(1.5, right - left), 22);
      const reason = store.hello.reasons[run.reason] ?? "unknown";
      if (MARKED[reason]) {
        context.fillStyle = this.color(MARKED[reason]);
        context.fillRect(left, 20, Math.max(1.5, right - left), 4);
      }
      const fits = (text) => context.measureText(text).width < right - left - 10;
      const text = [`${word} · ${reason}`, word].find(fits);
      if (text) {
        context.fillStyle = "#071018";
        context.fillText(text, left + 5, 12);
      }
    }
  }

  // The fresher the advice, the stronger its colour.
  drawAdvice(x, width) {
    const { context, store } = this;
    const { samples } = store;
    let begin = null;
    const flush = (end) => {
      if (!begin) return;
      const [left, right] = [Math.max(0, x(begin.seconds)), Math.min(width, x(end))];
      const word = store.hello.preferences[begin.preference];
      context.fillStyle = this.color(word === "abstain" ? "--quiet" : `--${word}`);
      context.globalAlpha = begin.strength;
      context.fillRect(left, 27, Math.max(1, right - left), 7);
      context.globalAlpha = 1;
    };
    for (const sample of samples) {
      const has = sample.advice_age_s !== null;
      const strength = has ? Math.max(0.2, 1 - Math.floor(sample.advice_age_s) / 12) : 0;
      const isSame = begin && has && begin.preference === sample.preference && begin.strength === strength;
      if (isSame) continue;
      flush(sample.taken_s);
      begin = has ? { seconds: sample.taken_s, preference: sample.preference, strength } : null;
    }
    flush(samples.at(-1).taken_s);
  }

  drawEvents(x, width) {
    const { context, store } = this;
    context.font = "10px system-ui, sans-serif";
    context.textAlign = "center";
    for (const event of store.events) {
      const at = x(this.secondsOf(event.tick));
      if (at < -4 || at > width + 4 || event.tick < store.samples[0].tick) continue;
      const [sign, color] = KINDS[event.kind] ?? KINDS.fault;
      context.fillStyle = this.color(color);
      context.fillText(sign, Math.max(5, Math.min(width - 5, at)), 46);
    }
    context.textAlign = "left";
  }

  drawScale(x, [from, to], [width, height]) {
    const { context } = this;
    const rough = ((to - from) / width) * 90;
    const power = 10 ** Math.floor(Math.log10(rough));
    const unit = [1, 2, 5, 10].map((k) => k * power).find((step) => step >= rough) ?? rough;
    context.fillStyle = this.color("--quiet");
    context.font = "10px system-ui, sans-serif";
    for (let at = Math.ceil(from / unit) * unit; at <= to; at += unit) {
      const place = x(at);
      if (place > width - 34) continue;
      context.fillRect(place, 56, 1, 4);
      context.fillText(`${+at.toFixed(2)} s`, place + 3, height - 8);
    }
  }

  drawHover(width) {
    const { context, store } = this;
    const seconds = this.secondsAt(this.hover);
    const run = this.drawn?.find((one) => one.from <= seconds && seconds <= one.to);
    const near = (event) => Math.abs(this.secondsOf(event.tick) - seconds) * width < 6 * (this.range()[1] - this.range()[0]);
    const event = store.events.findLast(near);
    const words = [`${seconds.toFixed(1)} s`];
    if (run) words.push(`${store.hello.drivers[run.driver]?.[0]}: ${store.hello.reasons[run.reason]}`);
    if (event) words.push(event.text);
    const text = words.join("  ·  ");
    context.font = "11px system-ui, sans-serif";
    const room = Math.min(width - 8, context.measureText(text).width + 14);
    const left = Math.max(2, Math.min(width - room - 2, this.hover - room / 2));
    context.fillStyle = this.color("--ink");
    context.fillRect(this.hover, 0, 1, 58);
    context.fillRect(left, 52, room, 20);
    context.fillStyle = this.color("--paper");
    context.fillText(text, left + 7, 62.5, room - 12);
  }
}
