// All runs: a card for each, those that need attention first.

import { Card } from "./card.js";
import { Theme } from "./theme.js";

const RETRY_MS = 1000;
const byId = (id) => document.getElementById(id);

const cards = new Map();
let drivers = [];
let told = null;
let connection = "connecting";
let source = null;

let isAsked = false;
function redraw() {
  if (isAsked) return;
  isAsked = true;
  requestAnimationFrame((now) => {
    isAsked = false;
    for (const card of cards.values()) if (!card.root.hidden) card.draw(now);
  });
}

const theme = new Theme(() => {
  for (const card of cards.values()) card.restyle();
  redraw();
});

function take(news) {
  told = news;
  const names = new Set(news.runs.map((run) => run.name));
  for (const [name, card] of cards) {
    if (names.has(name)) continue;
    card.root.remove();
    cards.delete(name);
  }
  for (const run of news.runs) {
    if (!cards.has(run.name)) {
      const card = new Card(run.name, drivers);
      card.restyle();
      cards.set(run.name, card);
    }
    cards.get(run.name).take(run);
  }
  arrange();
  drawState();
  redraw();
}

// The order of the server. A card that has the focus stays where it is in the document, so
// that it keeps it: the others move around it.
function arrange() {
  const main = byId("cards");
  const focused = document.activeElement?.closest?.(".card");
  const wanted = told.runs.map((run) => cards.get(run.name).root);
  const middle = wanted.indexOf(focused);
  wanted.forEach((root, k) => {
    if (root === focused) return;
    const anchor = middle > k ? focused : null;
    const isPlaced = anchor ? root.nextElementSibling === (wanted[k + 1] ?? null) : root.previousElementSibling === (wanted[k - 1] ?? null);
    if (!isPlaced || root.parentElement !== main) main.insertBefore(root, anchor);
  });
  filter();
}

function filter() {
  const words = byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const card of cards.values()) {
    const text = card.words();
    card.root.hidden = !words.every((word) => text.includes(word));
  }
}

function drawState() {
  const state = connection === "lost" ? ["gone", "disconnected"] : told ? ["live", "live"] : ["", "connecting"];
  [byId("mode").dataset.state, byId("mode").textContent] = state;
  const runs = told?.runs ?? [];
  const count = (...states) => runs.filter((run) => states.includes(run.state)).length;
  const parts = [
    [count("live", "faulty", "skipping", "starting"), "running"], [count("silent"), "silent"], [count("refused"), "not readable"],
    [count("faulty", "skipping"), "with faults or skipped ticks"], [count("ended"), "ended"],
  ];
  byId("summary").textContent = parts.filter(([number]) => number > 0).map(([number, word]) => `${number} ${word}`).join("  ·  ");
  const urgent = count("silent", "refused", "faulty", "skipping");
  document.title = `${urgent ? `(${urgent}) ` : ""}All runs - VLAPS`;
  const troubles = [told?.note, told?.left_out ? `${told.left_out} more runs live and are not shown` : ""].filter(Boolean);
  byId("trouble").textContent = troubles.join("; ");
  byId("trouble").hidden = !troubles.length;
  const isShown = [...cards.values()].some((card) => !card.root.hidden);
  const [title, text] = (() => {
    if (connection === "lost") return ["The page's server does not answer", "./vlaps view --all starts it; this page tries again every second"];
    if (!told || isShown) return ["", ""];
    return cards.size ? ["No run fits the filter", ""] : ["Nothing runs", "./vlaps up starts a run"];
  })();
  [byId("none").children[0].textContent, byId("none").children[1].textContent] = [title, text];
  byId("none").hidden = !title;
}

// A page that no one sees lets go of the connection, and the server of the runs.
function connect() {
  if (source || document.hidden) return;
  source = new EventSource("stream");
  source.addEventListener("open", () => {
    connection = "open";
    drawState();
  });
  source.addEventListener("hello", (event) => {
    drivers = JSON.parse(event.data).drivers;
    for (const [word, color] of drivers) document.documentElement.style.setProperty(`--${word}`, color);
    theme.apply();
  });
  source.addEventListener("status", (event) => take(JSON.parse(event.data)));
  source.addEventListener("error", () => {
    close();
    connection = "lost";
    drawState();
    setTimeout(connect, RETRY_MS);
  });
}

function close() {
  source?.close();
  source = null;
}

// To the next card in a direction, by where the cards lie.
function move(dx, dy) {
  const all = [...document.querySelectorAll(".card:not([hidden])")];
  const from = document.activeElement?.closest?.(".card");
  if (!from) {
    all[0]?.focus();
    return;
  }
  const middle = (card) => {
    const box = card.getBoundingClientRect();
    return [box.x + box.width / 2, box.y + box.height / 2];
  };
  const [x, y] = middle(from);
  const cost = (card) => {
    const [cx, cy] = middle(card);
    const [along, aside] = dx ? [dx * (cx - x), Math.abs(cy - y)] : [dy * (cy - y), Math.abs(cx - x)];
    return along > 20 ? along + 4 * aside : Infinity;
  };
  const best = all.reduce((one, other) => (cost(other) < cost(one) ? other : one), from);
  if (cost(best) < Infinity) best.focus();
}

function clear() {
  byId("filter").value = "";
  byId("filter").blur();
  filter();
  drawState();
}

const KEYS = [
  [["/"], "/", "filter by name, machine, state or driver", () => byId("filter").focus()],
  [["Escape"], "Esc", "clear the filter", clear],
  [["ArrowLeft"], "← → ↑ ↓", "to another card", () => move(-1, 0)],
  [["ArrowRight"], "", "", () => move(1, 0)],
  [["ArrowUp"], "", "", () => move(0, -1)],
  [["ArrowDown"], "", "", () => move(0, 1)],
  [[], "Enter", "open the page of this run; a on it returns", () => {}],
  [["d"], "d", "dark or light", () => theme.change()],
  [["?"], "?", "these keys", () => (byId("help").open ? byId("help").close() : byId("help").showModal())],
];

function listen() {
  const actions = new Map(KEYS.flatMap(([keys, , , action]) => keys.map((key) => [key, action])));
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.closest("input") && event.key !== "Escape";
    const action = actions.get(event.key);
    if (!action || isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    if (byId("help").open && event.key === "Escape") return;
    event.preventDefault();
    action();
  });
  const table = byId("help").querySelector("table");
  for (const [, key, text] of KEYS.filter(([, key]) => key)) {
    const row = table.insertRow();
    row.insertCell().textContent = key;
    row.insertCell().textContent = text;
  }
  byId("filter").addEventListener("input", () => {
    filter();
    drawState();
    redraw();
  });
  byId("theme").addEventListener("click", () => theme.change());
  byId("keys").addEventListener("click", () => byId("help").showModal());
  document.addEventListener("visibilitychange", () => (document.hidden ? close() : connect()));
  new ResizeObserver(redraw).observe(byId("cards"));
}

listen();
theme.begin();
drawState();
connect();
