// A rectangle drawn on a camera's picture: by pointer, by touch, or by keys.
const SMALLEST = 8; // px, either side
const STEP = 1 / 64; // of the picture's width, a key press
const START = 1 / 12; // likewise, half the first rectangle of the keys
const MOVES = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Selector {
  /** `chosen` gets the side, and x, y, width, height in whole pixels of the camera's picture; `tell` what a press did. */
  constructor(views, chosen, tell) {
    Object.assign(this, { views, chosen, tell, offered: false, armed: false, drag: null });
    this.button = document.getElementById("select");
    this.frames = views.map(({ canvas }) => {
      const frame = document.createElement("div");
      frame.className = "drawn";
      frame.hidden = true;
      canvas.before(frame);
      return frame;
    });
    views.forEach(({ canvas }, side) => {
      canvas.addEventListener("pointerdown", (event) => this.begin(event, side));
      canvas.addEventListener("pointermove", (event) => this.move(event));
      canvas.addEventListener("pointerup", (event) => this.end(event));
      canvas.addEventListener("pointercancel", () => this.cancel());
    });
  }

  offer(offered) {
    if (this.armed && !offered) this.tell("Selection ended: a target cannot be selected now.");
    if (this.offered && !offered) this.arm(false);
    this.offered = offered;
  }

  arm(armed) {
    this.armed = armed && this.offered;
    if (!this.armed) this.cancel();
    this.button.setAttribute("aria-pressed", String(this.armed));
    for (const { canvas } of this.views) {
      canvas.classList.toggle("armed", this.armed);
      canvas.tabIndex = this.armed ? 0 : -1;
    }
  }

  begin(event, side) {
    if (!this.armed || event.button || !this.views[side].found) return;
    event.preventDefault();
    this.views[side].canvas.focus({ preventScroll: true });
    this.views[side].canvas.setPointerCapture(event.pointerId);
    const at = this.place(event, side);
    this.show({ side, from: at, to: at, pointer: event.pointerId });
  }

  move(event) {
    if (this.drag?.pointer !== event.pointerId) return;
    this.show({ ...this.drag, to: this.place(event, this.drag.side) });
  }

  end(event) {
    if (this.drag?.pointer !== event.pointerId) return;
    this.move(event);
    this.send();
  }

  /** Arrows move a rectangle on the picture that has the focus, with Shift they size it. */
  key(event) {
    const side = this.views.findIndex(({ canvas }) => canvas === document.activeElement);
    if (event.key === "Escape" && this.armed) this.arm(false), this.tell("Selection ended.");
    else if (!this.armed || side < 0 || !this.views[side].found) return false;
    else if (event.key === "Enter") this.send();
    else if (event.key in MOVES) this.nudge(side, MOVES[event.key], event.shiftKey);
    else return false;
    return true;
  }

  nudge(side, [right, down], sizes) {
    const { width, height } = this.views[side].found;
    const step = STEP * width;
    if (this.drag?.side !== side) {
      const [x, y, half] = [width / 2, height / 2, START * width];
      return this.show({ side, from: [x - half, y - half], to: [x + half, y + half] });
    }
    let { from, to } = this.drag;
    if (!sizes) from = [from[0] + step * right, from[1] + step * down];
    to = [to[0] + step * right, to[1] + step * down];
    this.show({ side, from, to });
  }

  /** A pointer's place in the camera's picture, px. */
  place(event, side) {
    const { canvas, found } = this.views[side];
    const box = canvas.getBoundingClientRect();
    const inside = (v, size) => Math.min(Math.max(v, 0), size);
    return [inside(((event.clientX - box.left) * found.width) / box.width, found.width), inside(((event.clientY - box.top) * found.height) / box.height, found.height)];
  }

  show(drag) {
    this.frames.forEach((frame) => (frame.hidden = true));
    this.drag = drag;
    const [x, y, w, h] = this.box();
    const { found } = this.views[drag.side];
    const frame = this.frames[drag.side];
    frame.hidden = false;
    Object.assign(frame.style, { left: `${(100 * x) / found.width}%`, top: `${(100 * y) / found.height}%`, width: `${(100 * w) / found.width}%`, height: `${(100 * h) / found.height}%` });
  }

  box() {
    const { from, to, side } = this.drag;
    const { width, height } = this.views[side].found;
    const low = (i, size) => Math.max(Math.round(Math.min(from[i], to[i])), 0);
    const high = (i, size) => Math.min(Math.round(Math.max(from[i], to[i])), size);
    const [x, y] = [low(0), low(1)];
    return [x, y, Math.max(high(0, width) - x, 0), Math.max(high(1, height) - y, 0)];
  }

  send() {
    if (!this.drag) return;
    const [side, box] = [this.drag.side, this.box()];
    this.cancel();
    if (box[2] < SMALLEST || box[3] < SMALLEST) return this.tell(`Too small: a rectangle has ${SMALLEST} px or more.`);
    this.views[side].canvas.blur();
    this.arm(false);
    this.tell("Selection sent.");
    this.chosen(side ? "right" : "left", box);
  }

  cancel() {
    this.drag = null;
    this.frames.forEach((frame) => (frame.hidden = true));
  }
}
