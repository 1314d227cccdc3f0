// The page: joins store, scene, timeline, charts and panels; keys and buttons.

import { Store } from "./store.js";
import { SceneView } from "./scene.js";
import { Timeline } from "./timeline.js";
import { Charts } from "./charts.js";
import { Panels } from "./panels.js";
import { Theme } from "./theme.js";

const PACES = [0.1, 0.25, 0.5, 1, 2, 5, 10, 50];
const byId = (id) => document.getElementById(id);

const store = new Store();
const scene = new SceneView(byId("scene"), store);
const timeline = new Timeline(byId("timeline"), store);
const charts = new Charts(byId("charts"), store);
const panels = new Panels(store);

// Drawing happens once a frame, and only when something has changed.
const dirty = { scene: true, course: true };
let isAsked = false;
function redraw(what = ["scene", "course"]) {
  for (const part of what) dirty[part] = true;
  if (!isAsked) {
    isAsked = true;
    requestAnimationFrame(draw);
  }
}

function draw(now) {
  isAsked = false;
  const { isPlaying } = store;
  if (store.isRecording && isPlaying && store.at !== null) playOn(now);
  if (dirty.course) {
    dirty.course = false;
    const seconds = timeline.secondsOf(store.shownTick);
    timeline.draw();
    charts.draw(timeline.range(), seconds);
  }
  const before = store.shown;
  dirty.scene = false;
  if (scene.draw(now)) redraw(["scene"]);
  if (store.shown && store.shown !== before) drawFigures(store.shown);
  if (store.isRecording && store.isPlaying) redraw(["scene"]);
}

// Moves the shown tick of a recording on with the time that has passed.
let last = null;
let exact = null;
function playOn(now) {
  const passed = last === null ? 0 : Math.min(0.2, (now - last) / 1000);
  last = now;
  const rate = store.run?.rate_hz ?? 10;
  if (exact === null || Math.abs(exact - store.at) > 1.5) exact = store.at;
  exact += passed * rate * store.pace;
  const tick = Math.floor(exact);
  if (tick === store.at) return;
  if (tick >= store.lastTick) {
    store.isPlaying = false;
    exact = null;
    drawState();
  }
  store.at = Math.min(tick, store.lastTick);
  store.prefetch();
  if (!statusDue || now > statusDue) {
    statusDue = now + 1000;
    store.wantStatus();
  }
  dirty.course = true;
}
let statusDue = 0;

function drawFigures(shown) {
  byId("tick").textContent = String(shown.tick);
  byId("time").textContent = shown.taken_s.toFixed(1);
  const name = byId("driver-name");
  name.textContent = shown.is_takeover && shown.driver === "expert" ? "person" : shown.driver;
  name.style.background = `var(--${shown.driver})`;
  byId("driver-reason").textContent = shown.reason;
  byId("speed").firstElementChild.textContent = shown.speed_mps.toFixed(1);
  const { plan } = shown;
  byId("speed-note").textContent = plan ? `plan ${plan.outcome}, ${plan.cost_m.toFixed(0)} m, ${plan.planning_ms.toFixed(1)} ms` : "no plan";
  panels.drawScene();
}

function drawState() {
  const { run, hello } = store;
  byId("run").textContent = run?.name ?? "VLAPS";
  document.title = run ? `${run.name} - VLAPS` : "VLAPS";
  const facts = run ? [run.clock, `${+run.rate_hz.toFixed(1)} Hz`, run.planner.replaceAll("_", " "), `gate ${run.gate.replaceAll("_", " ")}`] : [];
  byId("facts").textContent = facts.join("  ·  ");
  const isBehind = store.at !== null;
  const state = (() => {
    if (store.connection === "lost") return ["gone", "disconnected"];
    if (store.isRecording) return ["recording", "recording"];
    if (!hello) return ["", "connecting"];
    if (!run) return ["gone", "no run"];
    return isBehind ? ["behind", "paused"] : ["live", "live"];
  })();
  byId("mode").dataset.state = state[0];
  byId("mode").textContent = state[1];
  byId("play").textContent = store.isPlaying && (store.isRecording || !isBehind) ? "❚❚" : "▶";
  byId("edge").hidden = store.isRecording;
  byId("pace").hidden = !store.isRecording;
  const none = byId("none");
  none.hidden = Boolean(run) && store.connection !== "lost";
  none.children[0].textContent = store.connection === "lost" ? "The page's server does not answer" : "No run";
  none.children[1].textContent = store.connection === "lost" ? "./vlaps view starts it; this page tries again every second" : (hello?.note ?? "");
  const words = [];
  if (store.trouble) words.push(store.trouble);
  if (store.isRecording && hello.note) words.push(hello.note);
  if (store.isRecording && store.indexed < 1) words.push(`reading the recording: ${Math.round(100 * store.indexed)} %`);
  byId("moment").textContent = words.join("  ·  ");
}

function drawEpisode() {
  const episode = store.status?.view?.episode;
  byId("episode").textContent = episode ? `episode ${episode.number}${episode.of ? ` of ${episode.of}` : ""}, seed ${episode.seed}` : "";
  byId("completion").firstElementChild.style.transform = `scaleX(${Math.max(0, Math.min(1, episode?.completion ?? 0))})`;
}

function toast(text) {
  const box = byId("toast");
  box.textContent = text;
  box.classList.add("shown");
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => box.classList.remove("shown"), 2200);
}

// A link that points at a tick: #tick=1234.
function tickOfLink() {
  const match = /^#tick=(\d{1,15})$/.exec(location.hash);
  return match ? Number(match[1]) : null;
}

// A living run is shown from the tick of the link on, if its scene is still kept.
let linked = tickOfLink();
function followLink() {
  if (linked === null || store.isRecording || !store.samples.length) return;
  const tick = linked;
  linked = null;
  if (tick >= store.firstTick && tick <= store.lastTick) {
    store.isPlaying = false;
    store.seek(tick);
  } else {
    toast(`tick ${tick} is not among the last minute of this run`);
  }
}

let hashTimer = null;
function keepLink() {
  clearTimeout(hashTimer);
  hashTimer = setTimeout(() => {
    const hash = store.at === null ? "" : `#tick=${store.at}`;
    if (location.hash !== hash) history.replaceState(null, "", hash || location.pathname);
  }, 300);
}

async function copyLink() {
  if (store.at === null) {
    store.isPlaying = false;
    store.seek(store.shownTick);
  }
  history.replaceState(null, "", `#tick=${store.at}`);
  try {
    await navigator.clipboard.writeText(location.href);
    toast(`link to tick ${store.at} copied`);
  } catch {
    toast("the address bar has the link");
  }
}

function playOrPause() {
  if (store.isRecording) {
    if (!store.isPlaying && store.at >= store.lastTick) store.seek(store.firstTick);
    store.isPlaying = !store.isPlaying;
    last = null;
  } else if (store.at === null) {
    store.isPlaying = false;
    store.seek(store.shownTick);
  } else {
    store.follow();
  }
  drawState();
  redraw();
}

function jump(direction) {
  const event = store.jump(direction);
  toast(event ? `${event.kind}: ${event.text}` : direction > 0 ? "no later event" : "no earlier event");
}

function setPace(pace) {
  store.pace = pace;
  byId("speed-select").value = String(pace);
  if (store.isRecording && store.at !== null) store.prefetch();
}

function changePace(by) {
  const index = PACES.indexOf(store.pace) + by;
  setPace(PACES[Math.max(0, Math.min(PACES.length - 1, index))]);
  toast(`speed ${store.pace}`);
}

const theme = new Theme(() => {
  scene.restyle();
  timeline.restyle();
  charts.restyle();
  panels.drawStatus();
  redraw();
});

// Of a page below that of all runs, the way back.
const isOfMany = /\/run\/[^/]+\/$/.test(location.pathname);
function showAll() {
  if (isOfMany) location.assign("../../");
}

function toggleLayer(key) {
  scene.layers.set(key, !scene.layers.get(key));
  for (const button of byId("layers").children) button.setAttribute("aria-pressed", String(scene.layers.get(button.dataset.key)));
  redraw(["scene"]);
}

// Key, words for the help, and what it does.
const KEYS = [
  [[" "], "space", "play or pause", playOrPause],
  [["ArrowLeft"], "←", "one step back (shift: ten)", (event) => store.step(event.shiftKey ? -10 : -1)],
  [["ArrowRight"], "→", "one step on (shift: ten)", (event) => store.step(event.shiftKey ? 10 : 1)],
  [["n"], "n", "next event: veto, takeover, contact, late tick, fault", () => jump(1)],
  [["p"], "p", "previous event", () => jump(-1)],
  [["Home"], "Home", "to the beginning", () => store.seek(store.firstTick)],
  [["End", "l"], "End, l", "to the newest", () => (store.isRecording ? store.seek(store.lastTick) : store.follow())],
  [["+", "="], "+", "faster", () => changePace(1)],
  [["-"], "-", "slower", () => changePace(-1)],
  [["z"], "z", "nearer (shift: farther; or the wheel)", () => scene.zoom(1 / 1.2)],
  [["Z"], "", "", () => scene.zoom(1.2)],
  [["u"], "u", "north up, or the car's heading up", () => { scene.isNorthUp = !scene.isNorthUp; redraw(["scene"]); }],
  [["t"], "t", "search tree", () => toggleLayer("tree")],
  [["c"], "c", "copy a link to this tick", copyLink],
  [["d"], "d", "dark or light", () => theme.change()],
  [["a"], isOfMany ? "a" : "", "all runs", showAll],
  [["?"], "?", "these keys", () => (byId("help").open ? byId("help").close() : byId("help").showModal())],
];

function listen() {
  const actions = new Map(KEYS.flatMap(([keys, , , action]) => keys.map((key) => [key, action])));
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.closest("select, input");
    const action = actions.get(event.key);
    if (!action || isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    // Space and Enter press a button that has the focus.
    if (event.key === " " && event.target.closest("button, summary")) return;
    event.preventDefault();
    action(event);
    drawState();
  });
  const buttons = { previous: () => jump(-1), next: () => jump(1), back: () => store.step(-1), forward: () => store.step(1), play: playOrPause, edge: () => store.follow(), link: copyLink, theme: () => theme.change(), keys: () => byId("help").showModal() };
  for (const [id, action] of Object.entries(buttons)) {
    byId(id).addEventListener("click", () => {
      action();
      drawState();
    });
  }
  const table = byId("help").querySelector("table");
  for (const [, key, text] of KEYS.filter(([, key]) => key)) {
    const row = table.insertRow();
    row.insertCell().textContent = key;
    row.insertCell().textContent = text;
  }
  const select = byId("speed-select");
  for (const pace of PACES) select.append(new Option(`${pace} x`, String(pace), pace === 1, pace === 1));
  select.addEventListener("change", () => setPace(Number(select.value)));
  for (const [key, name, color] of SceneView.layerList) {
    const button = document.createElement("button");
    const swatch = document.createElement("i");
    swatch.style.background = `var(${color})`;
    button.append(swatch, name);
    button.dataset.key = key;
    button.setAttribute("aria-pressed", String(scene.layers.get(key)));
    button.addEventListener("click", () => toggleLayer(key));
    byId("layers").append(button);
  }
  window.addEventListener("hashchange", () => {
    const tick = tickOfLink();
    if (tick !== null) store.seek(tick);
  });
  theme.begin();
  byId("all").hidden = !isOfMany;
  new ResizeObserver(() => redraw()).observe(document.body);
  new ResizeObserver(() => redraw()).observe(byId("stage"));
}

store.on("hello", () => {
  for (const [word, color] of store.hello.drivers) document.documentElement.style.setProperty(`--${word}`, color);
  scene.restyle();
  timeline.restyle();
  timeline.earlier = null;
  const tick = tickOfLink();
  if (tick !== null && store.isRecording && store.at === null) {
    store.at = tick;
    store.isPlaying = false;
  }
});
store.on("state", () => {
  drawState();
  redraw();
});
store.on("moment", () => {
  followLink();
  redraw();
});
store.on("draw", () => redraw());
store.on("seek", () => {
  drawState();
  keepLink();
  redraw();
});
store.on("status", () => {
  panels.drawStatus();
  drawEpisode();
});
store.on("events", () => panels.drawEvents());
store.dropped = (samples) => timeline.remember(samples);

listen();
panels.drawEvents();
drawState();
store.begin();
