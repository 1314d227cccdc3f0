// What the page knows: the run, its samples, scenes and events, and the tick that is shown.
// Of a living run the server sends; of a recording the page asks.

const SCENES_MAX = 1500;
const SAMPLES_MAX = 1200;
// As many as the server keeps.
const EVENTS_MAX = 1_000;
const CHUNK = 48;
const RETRY_MS = 1000;

export class Store {
  constructor() {
    this.hello = null;
    this.samples = [];
    this.events = [];
    this.scenes = new Map();
    this.status = null;
    this.newest = null;
    // The tick that is shown; null for the newest.
    this.at = null;
    this.isPlaying = true;
    this.pace = 1;
    this.connection = "connecting";
    this.listeners = new Map();
    this.pending = new Set();
    this.wanted = null;
    // When the run began, s on its clock; null before the first message.
    this.begun = null;
  }

  // Times of a run in seconds since its start: a tick is a number on the run's grid.
  sinceStart(one) {
    this.begun ??= one.taken_s - one.tick / (this.run?.rate_hz ?? Infinity);
    one.taken_s = Math.round(1e4 * (one.taken_s - this.begun)) / 1e4;
    return one;
  }

  on(name, listener) {
    const all = this.listeners.get(name) ?? [];
    all.push(listener);
    this.listeners.set(name, all);
  }

  tell(name) {
    for (const listener of this.listeners.get(name) ?? []) listener();
  }

  get isRecording() {
    return this.hello?.mode === "recording";
  }

  get run() {
    return this.hello?.run ?? null;
  }

  // Follows a run; a page that no one sees lets go of the connection.
  async begin() {
    const hello = await this.fetchJson("hello").catch(() => null);
    if (hello?.mode === "recording") {
      this.take(hello);
      this.connection = "open";
      await this.loadOverview();
      return;
    }
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.close();
      else this.connect();
    });
    this.connect();
  }

  connect() {
    if (this.source || document.hidden) return;
    const source = new EventSource("stream");
    this.source = source;
    source.addEventListener("open", () => {
      this.connection = "open";
      this.tell("state");
    });
    source.addEventListener("hello", (event) => this.take(JSON.parse(event.data)));
    source.addEventListener("status", (event) => {
      this.status = JSON.parse(event.data);
      this.tell("status");
    });
    source.addEventListener("moment", (event) => this.addMoment(JSON.parse(event.data)));
    source.addEventListener("error", () => {
      this.close();
      this.connection = "lost";
      this.tell("state");
      setTimeout(() => this.connect(), RETRY_MS);
    });
  }

  close() {
    this.source?.close();
    this.source = null;
  }

  take(hello) {
    this.hello = hello;
    if (hello.run) {
      if (this.session !== hello.run.supervisor) {
        this.scenes.clear();
        this.at = this.isRecording ? this.at : null;
        this.newest = null;
        this.status = null;
        this.begun = null;
      }
      this.session = hello.run.supervisor;
      // The server sends again what it keeps.
      this.samples = [];
      this.events = [];
    }
    this.tell("hello");
    this.tell("state");
  }

  addMoment(moment) {
    for (const sample of moment.samples) this.samples.push(this.sinceStart(sample));
    if (this.samples.length > SAMPLES_MAX) this.dropped?.(this.samples.splice(0, this.samples.length - SAMPLES_MAX));
    if (moment.scene) this.addScene(this.sinceStart(moment.scene));
    if (moment.scene) this.newest = moment.scene;
    this.tell("moment");
    if (moment.events.length) {
      this.events.push(...moment.events);
      if (this.events.length > EVENTS_MAX) this.events.splice(0, this.events.length - EVENTS_MAX);
      this.tell("events");
    }
  }

  addScene(scene) {
    this.scenes.delete(scene.tick);
    this.scenes.set(scene.tick, scene);
    // A map keeps the order of insertion: the oldest goes first.
    while (this.scenes.size > SCENES_MAX) this.scenes.delete(this.scenes.keys().next().value);
  }

  // The scene to draw: the newest one at or before the shown tick.
  scene() {
    if (this.at === null) return this.newest;
    const exact = this.scenes.get(this.at);
    if (exact) return exact;
    const reach = this.isRecording ? 3 * this.stride() + 2 : Infinity;
    let best = null;
    for (const scene of this.scenes.values()) {
      if (scene.tick <= this.at && scene.tick > (best?.tick ?? -1)) best = scene;
    }
    return best && this.at - best.tick <= reach ? best : (this.shown ?? null);
  }

  // The sample at or before a tick.
  sampleAt(tick) {
    const index = this.indexAt(tick);
    return index < 0 ? null : this.samples[index];
  }

  indexAt(tick) {
    let [low, high] = [0, this.samples.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.samples[middle].tick <= tick) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  indexOfTime(seconds) {
    let [low, high] = [0, this.samples.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.samples[middle].taken_s <= seconds) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  get firstTick() {
    return this.hello?.recording?.first_tick ?? this.samples[0]?.tick ?? 0;
  }

  get lastTick() {
    return this.hello?.recording?.last_tick ?? this.newest?.tick ?? this.samples.at(-1)?.tick ?? 0;
  }

  get shownTick() {
    return this.at ?? this.lastTick;
  }

  // Ticks between two drawn scenes at the present pace: at most 30 scenes a second.
  stride() {
    const rate = this.run?.rate_hz ?? 10;
    return Math.max(1, Math.floor((rate * this.pace) / 30));
  }

  seek(tick) {
    const goal = Math.max(this.firstTick, Math.min(this.lastTick, Math.round(tick)));
    this.at = goal;
    if (this.isRecording) {
      this.prefetch();
      this.wantStatus();
    } else if (!this.hasNear(goal)) {
      // From before this page was opened: the server keeps a minute.
      this.fetchChunk(goal, 1);
    }
    this.tell("seek");
  }

  // Whether a scene of less than two moments before the tick is here.
  hasNear(tick) {
    const reach = Math.max(1, (this.run?.rate_hz ?? 10) / 10);
    for (const known of this.scenes.keys()) {
      if (known <= tick && tick - known <= reach) return true;
    }
    return false;
  }

  // To the newest, and on.
  follow() {
    if (this.isRecording) return;
    this.at = null;
    this.isPlaying = true;
    this.tell("seek");
  }

  // One drawn scene on or back.
  step(count) {
    this.isPlaying = false;
    const at = this.shownTick;
    if (this.isRecording) {
      this.seek(at + count);
      return;
    }
    const ticks = [...this.scenes.keys()].sort((a, b) => a - b);
    let index = ticks.findLastIndex((tick) => tick <= at) + count;
    index = Math.max(0, Math.min(ticks.length - 1, index));
    if (ticks.length) this.seek(ticks[index]);
  }

  // To the next event that is worth it, or the one before.
  jump(direction) {
    const isWorth = (event) => !["episode", "swap"].includes(event.kind);
    const at = this.shownTick;
    const all = this.events.filter(isWorth);
    const goal = direction > 0 ? all.find((event) => event.tick > at) : all.findLast((event) => event.tick < at);
    if (!goal) return null;
    this.isPlaying = false;
    this.seek(goal.tick);
    return goal;
  }

  async fetchJson(path) {
    const response = await fetch(path);
    if (!response.ok) throw new Error(await response.text());
    return response.json();
  }

  // The whole course of a recording; while it is still being read, its beginning.
  async loadOverview() {
    const overview = await this.fetchJson("overview").catch(() => null);
    if (!overview) {
      this.connection = "lost";
      this.tell("state");
      setTimeout(() => this.loadOverview(), RETRY_MS);
      return;
    }
    this.connection = "open";
    this.samples = overview.samples.map((sample) => this.sinceStart(sample));
    this.events = overview.events;
    this.indexed = overview.indexed;
    if (overview.error) this.trouble = overview.error;
    this.hello.recording.last_tick = overview.last_tick;
    // Once: at the tick that the link points at, or at the beginning.
    if (!this.hasBegun) this.seek(this.at ?? this.firstTick);
    this.hasBegun = true;
    this.tell("moment");
    this.tell("events");
    this.tell("state");
    if (overview.indexed < 1) setTimeout(() => this.loadOverview(), 400);
  }

  // Asks for the scenes around the shown tick and ahead of it.
  prefetch() {
    const stride = this.stride();
    const span = CHUNK * stride;
    const begin = Math.floor(this.at / span) * span;
    const ahead = this.isPlaying ? 2 : 1;
    for (let k = 0; k < ahead; k += 1) this.fetchChunk(begin + k * span, stride);
  }

  async fetchChunk(from, stride) {
    const key = `${from}/${stride}`;
    if (this.pending.has(key) || from > this.lastTick) return;
    this.pending.add(key);
    try {
      const scenes = await this.fetchJson(`frames?from=${from}&count=${CHUNK}&stride=${stride}`);
      for (const scene of scenes) this.addScene(this.sinceStart(scene));
      this.tell("seek");
      // Scenes that were dropped meanwhile may be asked for again.
      setTimeout(() => this.pending.delete(key), 20_000);
    } catch {
      this.pending.delete(key);
    }
  }

  // The processes at the shown tick: one question at a time, the newest wins.
  async wantStatus() {
    const tick = this.at;
    if (this.wanted !== null) {
      this.wanted = tick;
      return;
    }
    this.wanted = tick;
    try {
      this.status = await this.fetchJson(`status?tick=${tick}`);
      this.tell("status");
    } catch {
      // The next seek asks again.
    }
    const later = this.wanted;
    this.wanted = null;
    if (later !== tick) setTimeout(() => this.wantStatus(), 150);
  }
}
