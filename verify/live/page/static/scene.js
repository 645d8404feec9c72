// Arm and LEDs in three dimensions: as measured, and by the encoders; or the arm, its planned way and
// the target. Lines on a canvas.
import { sized } from "./canvas.js";

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.turn = -0.7;
    this.tilt = 0.35;
    this.nearness = 1;
    this.facts = null;
    this.parts = null;
    this.dirty = true;
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("pointerdown", (event) => this.grab(event));
    canvas.addEventListener("wheel", (event) => this.zoom(event), { passive: false });
  }

  begin(facts) {
    this.facts = facts;
    this.parts = null;
    this.dirty = true;
  }

  show(parts) {
    this.parts = parts;
    this.dirty = true;
  }

  key(event) {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (event.key in steps) this.rotate(...steps[event.key]);
    else if (event.key === "+" || event.key === "=") this.nearness *= 1.1;
    else if (event.key === "-") this.nearness /= 1.1;
    else return;
    this.dirty = true;
    event.preventDefault();
  }

  grab(event) {
    this.canvas.setPointerCapture(event.pointerId);
    let last = [event.clientX, event.clientY];
    const move = (e) => {
      this.rotate((e.clientX - last[0]) * 0.008, (e.clientY - last[1]) * 0.008);
      last = [e.clientX, e.clientY];
    };
    const drop = () => {
      this.canvas.removeEventListener("pointermove", move);
      this.canvas.removeEventListener("pointerup", drop);
      this.canvas.removeEventListener("pointercancel", drop);
    };
    this.canvas.addEventListener("pointermove", move);
    this.canvas.addEventListener("pointerup", drop);
    this.canvas.addEventListener("pointercancel", drop);
  }

  zoom(event) {
    if (document.activeElement !== this.canvas) return; // scrolling the page must not zoom by the way
    this.nearness *= Math.exp(-event.deltaY * 0.001);
    this.dirty = true;
    event.preventDefault();
  }

  rotate(turn, tilt) {
    this.turn += turn;
    this.tilt = Math.min(Math.max(this.tilt + tilt, -1.5), 1.5);
    this.dirty = true;
  }

  /** As the bases stood for the pictures shown; before any, as the rig file says. */
  get cameras() {
    return this.parts?.cameras ?? this.facts.cameras;
  }

  draw(colours) {
    if (!this.facts) return;
    const { context, width, height } = sized(this.canvas);
    context.clearRect(0, 0, width, height);
    this.fit(width, height);
    this.floor(context, colours);
    this.frusta(context, colours);
    const parts = this.parts ?? {};
    this.arm(context, parts.measured ?? {}, colours.measured, [], 4);
    this.arm(context, parts.encoder ?? {}, colours.encoder, [7, 5], 2);
    this.thing(context, colours, parts);
    this.dirty = false;
  }

  /** A target, and the way to it. */
  thing(context, colours, { way, target }) {
    context.strokeStyle = context.fillStyle = colours.encoder;
    context.lineWidth = 1.5;
    if (way) this.path(context, way);
    if (!target) return;
    context.fillStyle = colours.tolerance;
    this.dot(context, target, 5);
  }

  /** Look at the middle of everything that is there, from far enough to see it all. */
  fit(width, height) {
    const points = [[0, 0, 0], ...this.cameras.map((camera) => camera.at_mm)];
    const { measured, encoder, target } = this.parts ?? {};
    for (const part of [measured, encoder]) points.push(...(part?.arm_mm ?? []), ...(part?.leds_mm ?? []));
    if (target) points.push(target);
    const low = [0, 1, 2].map((i) => Math.min(...points.map((p) => p[i])));
    const high = [0, 1, 2].map((i) => Math.max(...points.map((p) => p[i])));
    const middle = low.map((v, i) => (v + high[i]) / 2);
    const radius = Math.max(Math.hypot(...high.map((v, i) => v - low[i])) / 2, 200);
    const ease = this.middle ? 0.05 : 1; // what moves must not shake what it is seen against
    this.middle = (this.middle ?? middle).map((v, i) => v + ease * (middle[i] - v));
    this.radius = (this.radius ?? radius) + ease * (radius - (this.radius ?? radius));
    const scale = (this.nearness * Math.min(width, height)) / (2.1 * this.radius);
    const [ct, st, ci, si] = [Math.cos(this.turn), Math.sin(this.turn), Math.cos(this.tilt), Math.sin(this.tilt)];
    this.place = (p) => {
      const [x, y, z] = p.map((v, i) => v - this.middle[i]);
      const across = ct * x - st * y;
      const away = st * x + ct * y;
      return [width / 2 + scale * across, height / 2 - scale * (ci * z + si * away)];
    };
  }

  path(context, points) {
    context.beginPath();
    points.forEach((p) => context.lineTo(...this.place(p)));
    context.stroke();
  }

  floor(context, colours) {
    const reach = 400;
    context.lineWidth = 1;
    context.strokeStyle = colours.grid;
    for (let v = -reach; v <= reach; v += 100) {
      this.path(context, [[v, -reach, 0], [v, reach, 0]]);
      this.path(context, [[-reach, v, 0], [reach, v, 0]]);
    }
    const axes = [["x", [150, 0, 0]], ["y", [0, 150, 0]], ["z", [0, 0, 150]]];
    context.strokeStyle = context.fillStyle = colours.muted;
    context.font = "12px system-ui, sans-serif";
    for (const [name, tip] of axes) {
      this.path(context, [[0, 0, 0], tip]);
      const [x, y] = this.place(tip);
      context.fillText(name, x - (name === "z" ? 14 : 0), y);
    }
  }

  frusta(context, colours) {
    context.strokeStyle = context.fillStyle = colours.muted;
    const across = this.cameras.map(({ at_mm: o }) => this.place(o)[0]);
    this.cameras.forEach(({ rotation: r, at_mm: o }, side) => {
      const at = (x, y, z) => [0, 1, 2].map((i) => r[i][0] * x + r[i][1] * y + r[i][2] * z + o[i]);
      const corners = [at(-45, -28, 80), at(45, -28, 80), at(45, 28, 80), at(-45, 28, 80)];
      this.path(context, [...corners, corners[0]]);
      corners.forEach((corner) => this.path(context, [at(0, 0, 0), corner]));
      const outside = across[side] > across[1 - side] ? 1 : -1; // names of cameras that stand close do not meet
      const drawn = [at(0, 0, 0), ...corners].map((corner) => this.place(corner));
      const x = Math.max(...drawn.map(([right]) => right * outside)) * outside;
      context.textAlign = outside > 0 ? "left" : "right";
      context.fillText(side ? "right" : "left", x + 5 * outside, drawn[0][1] + 4);
    });
    context.textAlign = "left";
  }

  arm(context, part, colour, dash, thickness) {
    context.strokeStyle = context.fillStyle = colour;
    context.lineJoin = "round";
    if (part.arm_mm) {
      context.lineWidth = thickness;
      context.setLineDash(dash);
      this.path(context, part.arm_mm);
      context.setLineDash([]);
      for (const p of part.arm_mm) this.dot(context, p, thickness);
    }
    context.lineWidth = 1;
    const flange = part.arm_mm?.at(-1);
    for (const p of part.leds_mm ?? []) {
      if (flange) this.path(context, [flange, p]);
      this.dot(context, p, dash.length ? 2 : 3.5);
    }
  }

  dot(context, p, radius) {
    context.beginPath();
    context.arc(...this.place(p), radius, 0, 2 * Math.PI);
    context.fill();
  }
}
