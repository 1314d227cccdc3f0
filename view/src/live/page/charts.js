// Speed, both proposals' actions and the response over time, with uPlot.

const BEFORE_S = 30;

const PLOTS = [
  {
    key: "speed", title: "Speed", unit: "m/s", range: (low, high) => [Math.min(0, low ?? 0), Math.max(5, (high ?? 5) * 1.05)],
    lines: [["car", "--ink", (s) => s.speed_mps, 2], ["plan", "--plan", (s) => s.planned_mps, 1.2]],
  },
  {
    key: "steer", title: "Steering", unit: "", range: () => [-1.05, 1.05],
    lines: [["policy", "--policy", (s) => s.policy?.[0] ?? null, 1.4], ["expert", "--expert", (s) => s.expert?.[0] ?? null, 1.4], ["sent", "--ink", (s) => s.command[0], 2]],
  },
  {
    key: "pedal", title: "Pedal", unit: "", range: () => [-1.05, 1.05],
    lines: [["policy", "--policy", (s) => s.policy?.[1] ?? null, 1.4], ["expert", "--expert", (s) => s.expert?.[1] ?? null, 1.4], ["sent", "--ink", (s) => s.command[1], 2]],
  },
  {
    key: "response", title: "Command after its instant", unit: "ms", range: (low, high) => [0, Math.max(1, (high ?? 1) * 1.15)],
    lines: [["worst", "--scan", (s) => s.response_ms, 1.4]],
  },
];

export class Charts {
  constructor(root, store) {
    this.store = store;
    this.plots = PLOTS.map((plot) => this.make(root, plot));
    new ResizeObserver(() => {
      for (const { chart, box } of this.plots) chart.setSize({ width: Math.max(80, box.clientWidth), height: box.clientHeight });
    }).observe(root);
  }

  make(root, plot) {
    const holder = document.createElement("div");
    holder.className = "chart";
    const title = document.createElement("h3");
    title.append(plot.unit ? `${plot.title}, ${plot.unit}` : plot.title);
    const values = plot.lines.map(([name, color]) => {
      const [item, swatch, value] = ["span", "i", "b"].map((tag) => document.createElement(tag));
      swatch.style.background = `var(${color})`;
      item.append(swatch, `${name} `, value);
      title.append(item);
      return value;
    });
    const box = document.createElement("div");
    holder.append(title, box);
    root.append(holder);
    const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const axis = { stroke: () => color("--quiet"), font: "10px system-ui, sans-serif", grid: { stroke: () => color("--line"), width: 1 }, ticks: { show: false } };
    const chart = new uPlot({
      width: Math.max(80, box.clientWidth),
      height: box.clientHeight || 104,
      legend: { show: false },
      cursor: { sync: { key: "course" }, points: { show: false }, y: false, drag: { x: false, y: false } },
      scales: { x: { time: false }, y: { range: (_, low, high) => plot.range(low, high) } },
      axes: [{ ...axis, size: 20, gap: 3 }, { ...axis, size: 34, gap: 4, space: 22 }],
      series: [{}, ...plot.lines.map(([label, name, , width]) => ({ label, stroke: () => color(name), width, points: { show: false }, spanGaps: false }))],
      hooks: { draw: [(drawn) => this.drawNow(drawn, plot, color)] },
    }, [[], ...plot.lines.map(() => [])], box);
    box.addEventListener("click", (event) => {
      const over = chart.over.getBoundingClientRect();
      const seconds = chart.posToVal(event.clientX - over.left, "x");
      const sample = this.store.samples[this.store.indexOfTime(seconds)];
      if (!sample) return;
      this.store.isPlaying = false;
      this.store.seek(sample.tick);
    });
    return { plot, chart, box, values };
  }

  // The deadline, zero, and the tick that is shown.
  drawNow(chart, plot, color) {
    const { ctx: context, bbox } = chart;
    const line = (name, width, points) => {
      context.strokeStyle = color(name);
      context.lineWidth = width * devicePixelRatio;
      context.beginPath();
      context.moveTo(...points[0]);
      context.lineTo(...points[1]);
      context.stroke();
    };
    context.save();
    context.beginPath();
    context.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    context.clip();
    const run = this.store.run;
    if (plot.key === "response" && run && run.clock !== "lockstep") {
      const y = chart.valToPos(1000 / run.rate_hz, "y", true);
      line("--bad", 1.5, [[bbox.left, y], [bbox.left + bbox.width, y]]);
    }
    if (plot.key === "steer" || plot.key === "pedal") {
      const y = chart.valToPos(0, "y", true);
      line("--quiet", 0.7, [[bbox.left, y], [bbox.left + bbox.width, y]]);
    }
    if (this.store.at !== null && this.seconds !== undefined) {
      const x = chart.valToPos(this.seconds, "x", true);
      line("--ink", 1.5, [[x, bbox.top], [x, bbox.top + bbox.height]]);
    }
    context.restore();
  }

  draw(range, seconds) {
    const { store } = this;
    this.seconds = seconds;
    const [from, to] = store.isRecording ? [seconds - BEFORE_S, seconds + BEFORE_S / 2] : range;
    const first = Math.max(0, store.indexOfTime(from) - 1);
    const shown = store.samples.slice(first, store.indexOfTime(to) + 2);
    const times = shown.map((sample) => sample.taken_s);
    const now = store.sampleAt(store.shownTick);
    for (const { plot, chart, values } of this.plots) {
      chart.batch(() => {
        chart.setData([times, ...plot.lines.map(([, , value]) => shown.map(value))], false);
        chart.setScale("x", { min: from, max: to });
      });
      plot.lines.forEach(([, , value], k) => {
        const figure = now ? value(now) : null;
        values[k].textContent = figure === null ? "-" : figure.toFixed(2);
      });
    }
  }

  restyle() {
    for (const { chart } of this.plots) chart.redraw(false);
  }
}
