// The panels beside the scene. Whatever comes from a run is set as text.

import { kinds } from "./timeline.js";

const EVENTS_SHOWN = 120;

// An element with a class, text, and children.
function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

function table(titles, rows) {
  const head = make("thead", "", make("tr", "", ...titles.map((title) => make("th", "", title))));
  const body = rows.map((row) => make("tr", "", ...row.map((cell) => (cell instanceof HTMLTableCellElement ? cell : make("td", "", cell)))));
  return make("table", "", head, make("tbody", "", ...body));
}

function named(word, color) {
  const dot = make("i", "");
  dot.style.background = color;
  return make("td", "", make("span", "name", dot, word));
}

const figure = (value, digits) => (value === null || value === undefined ? "-" : value.toFixed(digits));

// 900 as "900 us", 1500 as "1.5 ms".
export function duration(us) {
  if (us < 1000) return `${us.toFixed(us < 10 ? 1 : 0)} us`;
  return us < 1e6 ? `${(us / 1e3).toFixed(us < 1e5 ? 2 : 0)} ms` : `${(us / 1e6).toFixed(2)} s`;
}

export class Panels {
  constructor(store) {
    this.store = store;
    this.process = "controller";
    this.body = (id) => document.querySelector(`#${id} > div`);
    this.color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  fill(id, ...children) {
    this.body(id).replaceChildren(...children.filter(Boolean));
  }

  show(id, isShown) {
    document.getElementById(id).hidden = !isShown;
  }

  // What changes with every scene.
  drawScene() {
    const { scene } = { scene: this.store.shown };
    if (!scene) return;
    const rows = ["expert", "policy"].map((name) => this.proposalRow(scene, name));
    const command = [
      named("sent", `var(--${scene.driver})`),
      this.meter(scene.command[0], `var(--${scene.driver})`),
      this.meter(scene.command[1], `var(--${scene.driver})`),
      make("td", "word", scene.lateness),
      "", "",
    ];
    this.fill("proposals", table(["", "steer", "pedal", "verdict", "gap", "safe"], [...rows, command]));
    this.drawAdvice(scene);
  }

  proposalRow(scene, name) {
    const proposal = scene[name];
    const title = name === "expert" && scene.is_takeover ? "person" : name;
    const head = named(title, `var(--${name})`);
    if (!proposal) return [head, "-", "-", make("td", "word quiet", "no proposal"), "-", "-"];
    const verdict = make("td", `word ${proposal.is_vetoed ? "bad" : ""}`, proposal.is_vetoed ? `veto: ${proposal.verdict}` : proposal.verdict);
    const gap = proposal.clearance_m >= 50 ? "free" : `${figure(proposal.clearance_m, 1)} m`;
    return [head, this.meter(proposal.steer, `var(--${name})`), this.meter(proposal.pedal, `var(--${name})`), verdict, gap, `${figure(proposal.safe_s, 1)} s`];
  }

  meter(value, color) {
    const fill = make("i", "");
    fill.style.background = color;
    fill.style.transform = `scaleX(${value})`;
    return make("td", "", make("span", "meter", fill), value.toFixed(2).replace("-0.00", "0.00").padStart(5));
  }

  drawAdvice(scene) {
    const { advice } = scene;
    if (!advice) {
      this.fill("advice", make("span", "quiet", "none: no judge has answered, or the run has none"));
      return;
    }
    const badge = make("span", "badge driven", advice.preference);
    badge.style.background = advice.preference === "abstain" ? "var(--quiet)" : `var(--${advice.preference})`;
    const total = (advice.age_s ?? 0) + advice.holds_s;
    const fill = make("i", "");
    fill.style.transform = `scaleX(${total > 0 ? Math.min(1, advice.holds_s / total) : 0})`;
    const holds = advice.holds_s > 0 ? `holds ${advice.holds_s.toFixed(1)} s more` : "expired";
    const age = advice.age_s === null ? "no question yet" : `question ${advice.age_s.toFixed(1)} s old`;
    this.fill(
      "advice",
      make("div", "row", make("span", "", badge, ` by ${advice.judge}`), make("span", "quiet", `${advice.answers} answers`)),
      make("div", "age", fill),
      make("div", "row quiet", make("span", "", age), make("span", advice.holds_s > 0 ? "" : "warn", holds)),
    );
  }

  // What changes once a second.
  drawStatus() {
    const { status } = this.store;
    if (!status) return;
    this.drawProcesses(status);
    this.drawHistograms(status);
    this.drawPolicy(status);
    this.drawJudge(status);
    this.drawLearning(status.learning);
  }

  drawProcesses(status) {
    const rows = status.view.processes.map((row) => {
      const isWell = ["running", "finished", "ready"].includes(row.state);
      const name = named(row.process, isWell ? "var(--good)" : "var(--bad)");
      name.title = `process ${row.pid ?? "-"}, ${row.state}`;
      const count = (value, className) => make("td", value > 0 ? className : "quiet", String(value));
      return [
        name, make("td", isWell ? "word quiet" : "word bad", row.state), row.rate_hz ? `${+row.rate_hz.toFixed(1)}` : "-", String(row.ticks),
        count(row.late, "warn"), count(row.skipped, "warn"), count(row.restarts, "bad"), row.priority ? String(row.priority) : make("td", "quiet", "-"),
      ];
    });
    const notes = [];
    if (status.lost) notes.push(`${status.lost} steps came faster than this page reads`);
    for (const late of status.late.slice(0, 3)) {
      notes.push(`latest: ${late.process} tick ${late.tick}, ${duration(late.late_us)} late in ${late.part}`);
    }
    this.fill(
      "processes",
      table(["", "", "Hz", "ticks", "late", "skip", "rest.", "prio"], rows),
      ...notes.map((note) => make("div", "quiet", note)),
    );
  }

  drawHistograms(status) {
    const names = [...new Set(status.histograms.map((one) => one.process))];
    if (!names.length) {
      this.fill("lateness", make("span", "quiet", "no durations yet"));
      return;
    }
    if (!names.includes(this.process)) [this.process] = names;
    const tabs = names.map((name) => {
      const tab = make("button", "", name);
      tab.setAttribute("aria-pressed", String(name === this.process));
      tab.addEventListener("click", () => {
        this.process = name;
        this.drawHistograms(this.store.status);
      });
      return tab;
    });
    const shown = status.histograms.filter((one) => one.process === this.process);
    const boxes = shown.map((one) => {
      const canvas = document.createElement("canvas");
      const over = one.deadline_us !== null && one.max_us > one.deadline_us;
      const figures = make("small", "", `p50 ${duration(one.p50_us)}  p99.9 ${duration(one.p999_us)}  `, make("span", over ? "bad" : "", `max ${duration(one.max_us)}`));
      return [make("div", "histogram", make("span", "", one.measure.replaceAll("_", " ")), figures, canvas), canvas, one];
    });
    const first = shown[0];
    const deadline = first?.deadline_us ? `red: the period, ${duration(first.deadline_us)}; ` : "";
    this.fill("lateness", make("div", "tabs", ...tabs), ...boxes.map(([box]) => box), make("div", "quiet", `${deadline}logarithmic from 1 us to 1 s, counts too`));
    for (const [, canvas, one] of boxes) this.drawBars(canvas, one);
  }

  drawBars(canvas, one) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const x = (us) => Math.max(0, Math.min(width, (Math.log10(us) / 6) * width));
    context.fillStyle = this.color("--raised");
    context.fillRect(0, 0, width, height);
    const most = Math.log10(1 + Math.max(...one.bars.map(([, count]) => count)));
    const step = 10 ** (1 / 12);
    for (const [from, count] of one.bars) {
      const tall = (Math.log10(1 + count) / most) * (height - 3);
      const isLate = one.deadline_us !== null && from >= one.deadline_us;
      context.fillStyle = this.color(isLate ? "--bad" : "--policy");
      context.fillRect(x(from), height - tall, Math.max(1.5, x(from * step) - x(from) - 1), tall);
    }
    context.fillStyle = this.color("--line");
    for (let power = 1; power < 6; power += 1) context.fillRect((power / 6) * width, 0, 1, height);
    if (one.deadline_us !== null) {
      context.fillStyle = this.color("--bad");
      context.fillRect(x(one.deadline_us) - 1, 0, 2, height);
    }
  }

  drawPolicy(status) {
    const { policy } = status.view;
    if (!policy) {
      this.fill("policy", make("span", "quiet", "none loaded: the expert drives"));
      return;
    }
    const inUse = policy.version ? `version ${policy.version}` : "none in use";
    const isBad = ["refused", "rolled_back"].includes(policy.state);
    this.fill(
      "policy",
      make("div", "row", make("b", "", inUse), make("span", "figure quiet", policy.version ? policy.hash.slice(0, 8) : "")),
      make("div", "row", make("span", "quiet", `last offered: ${policy.offered_version}`), make("span", isBad ? "bad" : "good", policy.state.replaceAll("_", " "))),
      policy.reason ? make("div", "bad", policy.reason) : null,
      policy.is_kept ? null : make("div", "warn", "not written to the disk: a restart does not begin with it"),
    );
  }

  drawJudge(status) {
    const { question, judge } = status;
    this.show("judge", Boolean(question || judge));
    const key = JSON.stringify([question, judge]);
    // Unchanged: the picture is not loaded again, and an open prompt stays open.
    if (key === this.judgeKey) return;
    this.judgeKey = key;
    const parts = [];
    if (question) {
      const badge = make("span", "badge driven", question.answer);
      const known = ["expert", "policy"].includes(question.answer);
      badge.style.background = known ? `var(--${question.answer})` : "var(--warn)";
      parts.push(make("div", "row", make("span", "", badge, ` question ${question.number}, tick ${question.tick}`), make("span", "quiet", `${question.latency_s.toFixed(2)} s`)));
      if (question.fault) parts.push(make("div", "bad", question.fault));
      for (const name of question.pictures.slice(0, 1)) {
        const picture = document.createElement("img");
        picture.src = `picture/${encodeURIComponent(name)}`;
        picture.alt = "the picture that the judge was asked about";
        parts.push(picture);
      }
      if (question.said) parts.push(make("pre", "", question.said));
      if (question.prompt) parts.push(make("details", "", make("summary", "", `the prompt (${question.model})`), make("pre", "", question.prompt)));
    }
    if (judge) {
      const counts = `${judge.questions} questions: expert ${judge.expert}, policy ${judge.policy}, abstained ${judge.abstained}, failed ${judge.failed}`;
      parts.push(make("div", "quiet", judge.cost_usd > 0 ? `${counts}; ${judge.cost_usd.toFixed(4)} USD` : counts));
      if (judge.trouble) parts.push(make("div", "warn", judge.trouble));
    }
    this.fill("judge", ...parts);
  }

  drawLearning(columns) {
    const has = Boolean(columns?.steps?.length);
    this.show("learning", has);
    if (!has) return;
    const box = this.body("learning");
    const names = ["actor_loss", "imitation_loss", "critic_loss"].filter((name) => columns[name]);
    const data = [columns.steps, ...names.map((name) => columns[name])];
    if (!this.curve) {
      const colors = ["--policy", "--expert", "--scan"];
      const axis = { stroke: () => this.color("--quiet"), grid: { stroke: () => this.color("--line"), width: 1 }, ticks: { show: false }, font: "10px system-ui, sans-serif" };
      const series = names.map((label, k) => ({ label: label.replaceAll("_", " "), stroke: () => this.color(colors[k]), width: 1.4 }));
      this.curve = new uPlot({ width: box.clientWidth, height: 150, scales: { x: { time: false } }, axes: [axis, { ...axis, size: 44 }], series: [{ label: "steps" }, ...series] }, data, box);
      return;
    }
    this.curve.setData(data);
  }

  drawEvents() {
    const { events } = this.store;
    const list = make("ol", "");
    for (const event of events.slice(-EVENTS_SHOWN).reverse()) {
      const [sign, color] = kinds[event.kind] ?? kinds.fault;
      const mark = make("span", "", sign);
      mark.style.color = `var(${color})`;
      const item = make("li", "", mark, make("b", "", String(event.tick)), make("span", "", event.text));
      item.tabIndex = 0;
      item.title = event.kind;
      const go = () => {
        this.store.isPlaying = false;
        this.store.seek(event.tick);
      };
      item.addEventListener("click", go);
      item.addEventListener("keydown", (pressed) => {
        if (pressed.key === "Enter") go();
      });
      list.append(item);
    }
    if (!events.length) this.fill("events", make("span", "quiet", "nothing yet"));
    else this.fill("events", list);
  }
}
