// A card: one run in small.

import { SceneView } from "./scene.js";

// As long as the server keeps a band: half seconds of a minute.
const PARTS = 120;
const MARK = 1 << 7;
// Two a second: the trail of a minute.
const SAMPLES_MAX = 120;
const WORDS = { silent: "silent", refused: "not readable", faulty: "fault", skipping: "skips ticks", live: "live", starting: "starting", ended: "ended" };
const FIGURES = [
  ["episode", "Episode"], ["late", "Late ticks"], ["skipped", "Skipped"], ["restarts", "Restarts"],
  ["vetoes", "Vetoes"], ["takeovers", "Takeovers"], ["contacts", "Contacts"], ["faults", "Faults"],
];

function make(tag, name, parent) {
  const element = document.createElement(tag);
  if (name) element.className = name;
  parent?.append(element);
  return element;
}

function duration(seconds) {
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  return `${Math.round(seconds / 60)} min`;
}

export class Card {
  constructor(name, drivers) {
    this.name = name;
    this.drivers = drivers;
    // What the drawing of the scene asks its store for.
    this.samples = [];
    this.hello = { drivers };
    this.run = { car_m: [4.5, 1.9] };
    this.newest = null;
    this.build();
    this.view = new SceneView(this.canvas, this, true);
    this.view.across = 56;
    this.view.layers.set("tree", false);
  }

  build() {
    const root = make("a", "card");
    // A name is letters, digits, - and _; the server checks it again.
    root.href = `run/${encodeURIComponent(this.name)}/`;
    const title = make("h2", "", root);
    make("b", "", title).textContent = this.name;
    this.machine = make("span", "machine", title);
    this.chip = make("span", "chip", title);
    const view = make("div", "view", root);
    this.canvas = make("canvas", "scene", view);
    const who = make("div", "who", view);
    this.driver = make("span", "driver", who);
    this.reason = make("span", "", who);
    const fast = make("div", "fast", view);
    this.speed = make("b", "", fast);
    make("small", "", fast).textContent = "m/s";
    this.fast = fast;
    this.age = make("div", "age", view);
    this.why = make("div", "why", view);
    this.band = make("canvas", "minute", root);
    this.band.title = "Who drove in the last minute; a stripe marks vetoes, takeovers, contacts and faults";
    const list = make("dl", "figures", root);
    this.figures = new Map();
    for (const [key, text] of FIGURES) this.figures.set(key, this.figure(list, text));
    this.outcomes = this.figure(list, "Outcomes");
    this.outcomes.parentElement.className = "wide";
    this.root = root;
  }

  figure(list, text) {
    const cell = make("div", "", list);
    make("dt", "", cell).textContent = text;
    return make("dd", "", cell);
  }

  // Takes in what the server tells of the run.
  take(told) {
    this.told = told;
    if (told.car_m[0] > 0) this.run.car_m = told.car_m;
    if (told.sample && told.sample !== this.lastSample) {
      this.lastSample = told.sample;
      this.addSample(JSON.parse(told.sample));
    }
    if (told.scene !== this.lastScene) {
      this.lastScene = told.scene;
      this.newest = told.scene ? JSON.parse(told.scene) : null;
    }
    this.write();
  }

  addSample(sample) {
    // Another run of this name begins anew.
    if (this.samples.length && sample.tick <= this.samples.at(-1).tick) this.samples = [];
    // The trail begins with the driver of now: a sample names it where it changes.
    const code = this.drivers.findIndex(([word]) => word === this.told.driver?.[0]);
    if (!this.samples.length && !sample.drivers.length) sample.drivers = [[sample.tick, code, 0]];
    this.samples.push(sample);
    if (this.samples.length > SAMPLES_MAX) this.samples.shift();
  }

  // Texts are set as texts: nothing that a run says has an effect.
  write() {
    const { told } = this;
    this.root.dataset.state = told.state;
    this.chip.textContent = WORDS[told.state] ?? told.state;
    const { machine } = told;
    const run = machine?.run ? `${machine.run} at ` : "";
    this.machine.textContent = machine ? `${machine.is_connected ? "" : "not connected: "}${run}${machine.address}` : "this machine";
    this.machine.title = machine ? `from ${run}${machine.address}, as ${machine.role}` : "";
    const [driver, reason] = told.driver ?? ["", ""];
    this.driver.hidden = !driver;
    this.driver.textContent = driver;
    this.driver.style.background = `var(--${driver || "quiet"})`;
    this.reason.textContent = reason;
    const speed = told.episode?.speed_mps ?? this.newest?.speed_mps;
    this.fast.hidden = speed === undefined;
    this.speed.textContent = speed?.toFixed(1) ?? "";
    const age = told.age_s === null ? "" : duration(told.age_s);
    this.age.textContent = told.state === "ended" ? `ended ${age} ago` : age && `newest step ${age} ago`;
    this.why.textContent = told.note;
    this.why.hidden = !told.note;
    const of = told.episode?.of ? ` of ${told.episode.of}` : "";
    this.put("episode", told.episode ? `${told.episode.number}${of}` : "-");
    for (const key of ["late", "skipped", "vetoes", "takeovers", "contacts", "faults"]) this.put(key, told[key]);
    const restarts = told.restarts.reduce((sum, [, count]) => sum + count, 0);
    this.put("restarts", restarts, told.restarts.map(([name, count]) => `${name}: ${count}`).join(", "));
    const outcomes = told.outcomes.map(([word, count]) => `${count} ${word.replaceAll("_", " ")}`).join(", ");
    this.outcomes.textContent = outcomes || "none yet";
    const since = `since this page began to read, ${duration(told.read_s)} ago`;
    for (const key of ["vetoes", "takeovers", "contacts", "faults"]) this.figures.get(key).parentElement.title = since;
    this.outcomes.parentElement.title = since;
  }

  put(key, value, title = "") {
    const cell = this.figures.get(key);
    cell.textContent = String(value);
    cell.className = value === 0 || value === "-" ? "zero" : "";
    if (title) cell.title = title;
  }

  // The words by which the filter finds it.
  words() {
    const { told } = this;
    return [told.name, WORDS[told.state], told.machine ? `${told.machine.run} ${told.machine.address}` : "this machine", ...(told.driver ?? []), told.clock].join(" ").toLowerCase();
  }

  draw(now) {
    this.view.draw(now);
    this.drawBand();
  }

  restyle() {
    this.view.restyle();
  }

  drawBand() {
    const canvas = this.band;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = this.view.colors.line;
    context.fillRect(0, 0, width, height);
    const { band } = this.told;
    const step = width / PARTS;
    band.forEach((bits, k) => {
      const x = width - (band.length - k) * step;
      const drove = this.drivers.filter((_, bit) => bits & (1 << bit));
      drove.forEach(([, color], row) => {
        context.fillStyle = color;
        context.fillRect(x, (row * height) / drove.length, step + 0.6, height / drove.length);
      });
      if (bits & MARK) {
        context.fillStyle = this.view.colors.ink;
        context.fillRect(x, height - 4, step + 0.6, 4);
      }
    });
  }

  // What the scene asks its store for.
  scene() {
    return this.newest;
  }

  indexAt(tick) {
    return this.samples.findLastIndex((sample) => sample.tick <= tick);
  }

  tell() {}
}
