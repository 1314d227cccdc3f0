// The scene from above. World frame in metres; the camera follows the car.

const LAYERS = [
  ["scan", "Scan", "--scan"],
  ["plan", "Plan", "--plan"],
  ["expert", "Expert", "--expert"],
  ["policy", "Policy", "--policy"],
  ["trail", "Trail", "--quiet"],
  ["tree", "Tree", "--warn"],
];
const NEAR_M = 18;
const FAR_M = 160;
const TREE_MS = 250;

export class SceneView {
  // A small one has no wheel, no labels, and a camera that jumps.
  constructor(canvas, store, isSmall = false) {
    this.isSmall = isSmall;
    this.canvas = canvas;
    this.store = store;
    this.context = canvas.getContext("2d");
    this.across = 62;
    this.isNorthUp = false;
    this.layers = new Map(LAYERS.map(([key]) => [key, key !== "tree"]));
    this.tree = null;
    this.treeAsked = 0;
    this.camera = null;
    if (isSmall) return;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.0012));
    }, { passive: false });
    this.listenToPinch();
  }

  listenToPinch() {
    const fingers = new Map();
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    this.canvas.addEventListener("pointerdown", (event) => fingers.set(event.pointerId, event));
    for (const name of ["pointerup", "pointercancel", "pointerleave"]) {
      this.canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
    }
    this.canvas.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      const before = fingers.size === 2 ? spread() : 0;
      fingers.set(event.pointerId, event);
      if (before > 0) this.zoom(before / Math.max(1, spread()));
    });
  }

  static get layerList() {
    return LAYERS;
  }

  zoom(factor) {
    this.across = Math.max(NEAR_M, Math.min(FAR_M, this.across * factor));
    this.store.tell("draw");
  }

  // Colours of the theme, read once after it has changed.
  restyle() {
    const style = getComputedStyle(document.documentElement);
    const names = ["ground", "road", "edge", "scan", "plan", "ink", "quiet", "line", "expert", "policy", "brake", "warn", "bad", "panel"];
    this.colors = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }

  driverColor(word) {
    return this.colors[word] ?? this.colors.quiet;
  }

  // Draws; true while the camera still moves.
  draw(now) {
    const { canvas, context, store } = this;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = this.colors.ground;
    context.fillRect(0, 0, width, height);
    const scene = store.scene();
    store.shown = scene;
    if (!scene) return false;
    const pose = this.follow(scene, now);
    const scale = Math.min(width, height * 1.35) / this.across;
    // The car stands low in the picture: what matters is ahead.
    const [cx, cy] = [width / 2, this.isNorthUp ? height / 2 : height * 0.7];
    const turn = this.isNorthUp ? 0 : Math.PI / 2 - pose[2];
    const [sin, cos] = [Math.sin(turn), Math.cos(turn)];
    this.view = {
      scale,
      at: (x, y) => {
        const [dx, dy] = [x - pose[0], y - pose[1]];
        return [cx + (cos * dx - sin * dy) * scale, cy - (sin * dx + cos * dy) * scale];
      },
    };
    this.drawRoad(scene);
    this.drawRings(scene, width);
    if (this.layers.get("trail")) this.drawTrail(scene);
    if (this.layers.get("tree")) this.drawTree(scene);
    if (this.layers.get("scan")) this.drawScan(scene);
    if (this.layers.get("plan") && scene.plan) this.drawPlan(scene.plan);
    for (const name of ["policy", "expert"]) {
      if (this.layers.get(name) && scene[name]) this.drawRollout(scene, name);
    }
    this.drawTracks(scene);
    this.drawCar(scene, pose);
    return this.isMoving;
  }

  // The camera glides from scene to scene; it jumps where the car does.
  follow(scene, now) {
    const goal = scene.ego_world;
    const camera = this.camera;
    if (!camera || camera.episode !== scene.episode || Math.hypot(goal[0] - camera.to[0], goal[1] - camera.to[1]) > 12) {
      this.camera = { from: goal, to: goal, began: now, tick: scene.tick, episode: scene.episode, pose: goal };
    } else if (camera.tick !== scene.tick) {
      this.camera = { from: camera.pose, to: goal, began: now, tick: scene.tick, episode: scene.episode, pose: camera.pose };
    }
    const { from, to, began } = this.camera;
    const share = this.isSmall ? 1 : Math.min(1, (now - began) / 60);
    const turn = Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2]));
    this.camera.pose = [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]), from[2] + share * turn];
    this.isMoving = share < 1;
    return this.camera.pose;
  }

  // From the body frame of a pose to the screen.
  from([x, y, heading]) {
    const [sin, cos] = [Math.sin(heading), Math.cos(heading)];
    return ([a, b]) => this.view.at(x + cos * a - sin * b, y + sin * a + cos * b);
  }

  path(points, close) {
    const { context } = this;
    context.beginPath();
    points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    if (close) context.closePath();
  }

  drawRoad(scene) {
    const { context, colors } = this;
    const place = this.from(scene.ego_world);
    const ahead = scene.edges.map((edge) => edge.map(place));
    context.fillStyle = colors.road;
    context.strokeStyle = colors.road;
    context.lineWidth = 1;
    // Behind: where the road was when the car was there.
    const behind = this.roadBehind(scene);
    for (const [a, b] of behind) {
      this.path([a[0], b[0], b[1], a[1]], true);
      context.fill();
      context.stroke();
    }
    if (ahead[0].length > 1) {
      this.path([...ahead[0], ...ahead[1].toReversed()], true);
      context.fill();
    }
    context.strokeStyle = colors.edge;
    context.lineWidth = 1.6;
    for (const [a, b] of behind) {
      for (const side of [0, 1]) {
        this.path([a[side], b[side]]);
        context.globalAlpha = 0.35;
        context.stroke();
      }
    }
    context.globalAlpha = 1;
    for (const edge of ahead) {
      this.path(edge);
      context.stroke();
    }
    context.fillStyle = colors.quiet;
    for (const checkpoint of scene.checkpoints) {
      const [x, y] = place(checkpoint);
      this.path([[x, y - 5], [x + 5, y], [x, y + 5], [x - 5, y]], true);
      context.fill();
    }
  }

  // Pairs of neighbouring cuts across the road, each of its left and right edge.
  roadBehind(scene) {
    const { samples } = this.store;
    const last = this.store.indexAt(scene.tick);
    const pairs = [];
    let before = null;
    for (let k = Math.max(0, last - 400); k <= last; k += 1) {
      const { ego_world: [x, y, heading], road: [left, right, turned], episode } = samples[k];
      const near = Math.hypot(x - scene.ego_world[0], y - scene.ego_world[1]) < this.across * 1.5;
      if (episode !== scene.episode || !near) {
        before = null;
        continue;
      }
      const direction = heading - turned;
      const [nx, ny] = [-Math.sin(direction), Math.cos(direction)];
      const cut = [this.view.at(x + left * nx, y + left * ny), this.view.at(x - right * nx, y - right * ny)];
      const isOne = before && Math.abs(before.left - left) < 3 && Math.abs(before.right - right) < 3 && Math.hypot(before.x - x, before.y - y) < 12;
      if (isOne) pairs.push([before.cut, cut]);
      before = { cut, left, right, x, y };
    }
    return pairs;
  }

  drawRings(scene, width) {
    const { context, colors } = this;
    const [x, y] = this.view.at(scene.ego_world[0], scene.ego_world[1]);
    context.strokeStyle = colors.quiet;
    context.fillStyle = colors.quiet;
    context.globalAlpha = 0.16;
    context.lineWidth = 1;
    for (let r = 10; r <= 60; r += 10) {
      context.beginPath();
      context.arc(x, y, r * this.view.scale, 0, 2 * Math.PI);
      context.stroke();
    }
    if (this.isSmall) {
      context.globalAlpha = 1;
      return;
    }
    context.globalAlpha = 0.55;
    context.font = "10px system-ui, sans-serif";
    for (let r = 10; r <= 60; r += 10) {
      const at = x + r * this.view.scale;
      if (at < width - 24) context.fillText(`${r} m`, at + 3, y - 3);
    }
    context.globalAlpha = 1;
  }

  drawTrail(scene) {
    const { context, store } = this;
    const last = store.indexAt(scene.tick);
    const from = Math.max(1, last - 400);
    let driver = this.driverBefore(from);
    let points = [];
    const stroke = () => {
      if (points.length > 1) {
        this.path(points);
        context.strokeStyle = this.driverColor(store.hello?.drivers[driver]?.[0]);
        context.stroke();
      }
      points = points.slice(-1);
    };
    context.lineWidth = 3.5;
    context.lineJoin = "round";
    context.globalAlpha = 0.7;
    for (let k = from; k <= last; k += 1) {
      const sample = store.samples[k];
      if (sample.episode !== scene.episode) {
        stroke();
        points = [];
      } else {
        points.push(this.view.at(sample.ego_world[0], sample.ego_world[1]));
      }
      if (sample.drivers.length) {
        stroke();
        driver = sample.drivers.at(-1)[1];
      }
    }
    stroke();
    context.globalAlpha = 1;
  }

  // The driver in charge before a sample, by code.
  driverBefore(index) {
    for (let k = index; k >= 0; k -= 1) {
      const { drivers } = this.store.samples[k] ?? { drivers: [] };
      if (drivers.length) return drivers.at(-1)[1];
    }
    return -1;
  }

  drawScan(scene) {
    const { context, colors } = this;
    const place = this.from(scene.ego_world);
    const [first, spacing] = scene.scan_rad;
    const [x, y] = scene.scan_from;
    const ends = scene.scan_m.map((range, beam) => {
      const angle = first + beam * spacing;
      return place([x + range * Math.cos(angle), y + range * Math.sin(angle)]);
    });
    if (!ends.length) return;
    // The area of a partial scan is closed by where its beams begin.
    this.path([...ends, ...(ends.length * spacing < 2 * Math.PI - 1e-6 ? [place([x, y])] : [])], true);
    context.fillStyle = colors.ink;
    context.globalAlpha = 0.045;
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = colors.scan;
    const size = Math.max(2, Math.min(4.5, this.view.scale * 0.3));
    ends.forEach(([x, y], beam) => {
      if (scene.scan_m[beam] < scene.scan_max_m - 0.01) context.fillRect(x - size / 2, y - size / 2, size, size);
    });
  }

  drawPlan(plan) {
    const { context, colors } = this;
    const place = this.from(plan.origin_world);
    const points = plan.points.map(place);
    this.path(points);
    context.strokeStyle = colors.plan;
    context.lineWidth = 2;
    context.setLineDash([7, 5]);
    context.stroke();
    context.setLineDash([]);
    context.fillStyle = colors.plan;
    for (const [x, y] of points) {
      context.beginPath();
      context.arc(x, y, 2.4, 0, 2 * Math.PI);
      context.fill();
    }
    const [x, y] = place(plan.goal);
    context.beginPath();
    context.arc(x, y, 6, 0, 2 * Math.PI);
    context.lineWidth = 2;
    context.stroke();
  }

  // The swath of the car's width, and its middle.
  drawRollout(scene, name) {
    const { context } = this;
    const proposal = scene[name];
    const place = this.from(scene.ego_world);
    const points = proposal.rollout.map(place);
    const color = this.colors[name];
    context.strokeStyle = color;
    context.lineJoin = "round";
    context.globalAlpha = 0.15;
    context.lineWidth = (this.store.run?.car_m[1] ?? 1.9) * this.view.scale;
    this.path(points);
    context.stroke();
    context.globalAlpha = 1;
    context.lineWidth = 2.6;
    this.path(points);
    context.stroke();
    const [x, y] = points.at(-1);
    context.beginPath();
    if (proposal.is_vetoed) {
      context.strokeStyle = this.colors.bad;
      context.moveTo(x - 6, y - 6);
      context.lineTo(x + 6, y + 6);
      context.moveTo(x + 6, y - 6);
      context.lineTo(x - 6, y + 6);
      context.lineWidth = 3;
      context.stroke();
    } else {
      context.fillStyle = color;
      context.arc(x, y, 4, 0, 2 * Math.PI);
      context.fill();
    }
  }

  drawTracks(scene) {
    const { context, colors } = this;
    const place = this.from(scene.ego_world);
    for (const track of scene.tracks) {
      const [x, y] = place(track.at);
      const [vx, vy] = track.velocity_mps;
      const [tx, ty] = place([track.at[0] + vx, track.at[1] + vy]);
      context.strokeStyle = colors.warn;
      context.fillStyle = colors.warn;
      context.lineWidth = 1.8;
      context.beginPath();
      context.arc(x, y, Math.max(0.9, track.radius_m) * this.view.scale, 0, 2 * Math.PI);
      context.stroke();
      this.path([[x, y], [tx, ty]]);
      context.stroke();
      context.font = "11px system-ui, sans-serif";
      context.fillText(`${Math.hypot(vx, vy).toFixed(1)} m/s`, tx + 5, ty + 3);
    }
  }

  drawCar(scene, pose) {
    const { context } = this;
    const [length, width] = this.store.run?.car_m ?? [4.5, 1.9];
    const place = this.from(pose);
    const [a, b] = [length / 2, width / 2];
    const color = this.driverColor(scene.driver);
    this.path([[a, b * 0.72], [a, -b * 0.72], [a * 0.8, -b], [-a, -b], [-a, b], [a * 0.8, b]].map(place), true);
    context.shadowColor = color;
    context.shadowBlur = 16;
    context.fillStyle = color;
    context.fill();
    context.shadowBlur = 0;
    context.lineWidth = 1.5;
    context.strokeStyle = "#0b0f14";
    context.stroke();
    this.path([[a * 0.45, b * 0.74], [a * 0.45, -b * 0.74], [a * 0.02, -b * 0.66], [a * 0.02, b * 0.66]].map(place), true);
    context.fillStyle = "#0b0f14b0";
    context.fill();
  }

  // The search tree is in no message: the server plans again, a few times a second.
  async askForTree(scene, now) {
    if (this.treePending || now - this.treeAsked < TREE_MS || this.tree?.tick === scene.tick) return;
    this.treePending = true;
    this.treeAsked = now;
    try {
      this.tree = await this.store.fetchJson(this.store.isRecording ? `tree?tick=${scene.tick}` : "tree");
      this.store.tell("draw");
    } catch {
      this.tree = null;
    }
    this.treePending = false;
  }

  drawTree(scene) {
    this.askForTree(scene, performance.now());
    if (!this.tree || Math.abs(this.tree.tick - scene.tick) > (this.store.run?.rate_hz ?? 10)) return;
    const { context } = this;
    const place = this.from(this.tree.origin_world);
    context.lineWidth = 1.1;
    context.globalAlpha = 0.8;
    this.tree.ways.forEach((way, k) => {
      // From violet, near, to orange, far.
      context.strokeStyle = `hsl(${270 + 120 * this.tree.costs[k]} 70% 62%)`;
      this.path(way.map(place));
      context.stroke();
    });
    context.globalAlpha = 1;
  }
}
