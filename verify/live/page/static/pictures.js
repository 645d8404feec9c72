// A camera's picture with what was found in it: LEDs, a board's corners over what is covered, or a target.
import { sized } from "./canvas.js";

const ENOUGH = 12; // corners in a cell, from which it is as green as it gets

export class PictureView {
  constructor(canvas, caption, side) {
    Object.assign(this, { canvas, caption, side, names: [], latest: 0, found: null });
  }

  async show(found, jpeg, cells) {
    const number = ++this.latest;
    let image;
    try {
      image = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
    } catch {
      return; // half a picture; the next one comes at once
    }
    if (number !== this.latest) return image.close();
    this.found = found;
    this.canvas.style.aspectRatio = String(found.width / found.height);
    const { context, width, height } = sized(this.canvas);
    context.drawImage(image, 0, 0, width, height);
    image.close();
    const scale = width / found.width;
    if ("target" in found) this.target(context, found.target, scale);
    else if (found.corners) this.board(context, found.corners, cells, scale, width, height);
    else if (found.spots) this.spots(context, found.spots, scale);
    else this.leds(context, found.leds, scale);
  }

  leds(context, leds, scale) {
    context.font = "600 12px system-ui, sans-serif";
    for (const { led, x, y } of leds) mark(context, (x + 0.5) * scale, (y + 0.5) * scale, String(led + 1));
    const names = leds.map(({ led }) => `${led + 1} ${this.names[led] ?? ""}`.trim());
    this.caption.textContent = `${this.side.toLowerCase()}: ${names.length ? `LEDs ${names.join(", ")}` : "no LED identified"}`;
    this.canvas.setAttribute("aria-label", `${this.side} camera, ${leds.length} of ${this.names.length} LEDs identified`);
  }

  spots(context, spots, scale) {
    context.font = "600 12px system-ui, sans-serif";
    for (const [x, y] of spots) mark(context, (x + 0.5) * scale, (y + 0.5) * scale, "");
    const said = `${spots.length} ${spots.length === 1 ? "spot" : "spots"}`;
    this.caption.textContent = `${this.side.toLowerCase()}: ${said}`;
    this.canvas.setAttribute("aria-label", `${this.side} camera, ${said}`);
  }

  target(context, target, scale) {
    const at = (v) => (v + 0.5) * scale; // centres are at whole numbers
    const twice = (path, colour) => {
      for (const [width, style] of [[4, "#000a"], [1.8, colour]]) {
        Object.assign(context, { lineWidth: width, strokeStyle: style });
        context.beginPath();
        path();
        context.stroke();
      }
    };
    const { window, outline, place, status } = target ?? { status: "no target" };
    const missing = target && !outline ? ", not seen here" : "";
    context.setLineDash([5, 4]);
    if (window) twice(() => context.rect(window[0] * scale, window[1] * scale, window[2] * scale, window[3] * scale), "#f2f2f2");
    context.setLineDash([]);
    if (outline) {
      const [x, y] = outline.centre.map(at);
      const [a, b] = outline.axes.map((axis) => (axis * scale) / 2);
      twice(() => context.ellipse(x, y, a, b, (outline.angle_deg * Math.PI) / 180, 0, 2 * Math.PI), "#ffe63c");
    }
    if (place) {
      const [x, y] = place.map(at);
      twice(() => [[7, 14], [-7, -14]].forEach(([near, far]) => (context.moveTo(x + near, y), context.lineTo(x + far, y), context.moveTo(x, y + near), context.lineTo(x, y + far))), "#4fd6ff");
    }
    this.caption.textContent = `${this.side.toLowerCase()}: ${status}${missing}${place ? "; cross: estimated place" : ""}`;
    this.canvas.setAttribute("aria-label", `${this.side} camera, target ${status}${outline ? `, at ${outline.centre.map(Math.round).join(", ")} pixels` : ""}`);
  }

  board(context, corners, cells, scale, width, height) {
    cells.forEach((row, r) =>
      row.forEach((count, c) => {
        if (!count) return;
        context.fillStyle = `rgba(44, 199, 154, ${0.12 + 0.28 * Math.min(count / ENOUGH, 1)})`;
        context.fillRect((c * width) / row.length, (r * height) / cells.length, width / row.length, height / cells.length);
      }),
    );
    corners.forEach(([x, y], i) => {
      context.fillStyle = i ? "#ffdc3c" : "#ff5a4d"; // the first corner tells which way up it is seen
      context.beginPath();
      context.arc((x + 0.5) * scale, (y + 0.5) * scale, i ? 2.5 : 4.5, 0, 2 * Math.PI);
      context.fill();
    });
    const covered = cells.flat().filter((count) => count).length;
    const share = cells.length ? Math.round((100 * covered) / cells.flat().length) : 0;
    const said = `${corners.length ? `${corners.length} corners` : "no board"}, ${share} % covered`;
    this.caption.textContent = `${this.side.toLowerCase()}: ${said}`;
    this.canvas.setAttribute("aria-label", `${this.side} camera, ${said}`);
  }
}

function mark(context, x, y, text) {
  context.lineWidth = 3;
  context.strokeStyle = "#000a";
  context.beginPath();
  context.arc(x, y, 9, 0, 2 * Math.PI);
  context.stroke();
  context.strokeText(text, x + 11, y - 7);
  context.lineWidth = 1.5;
  context.strokeStyle = "#50c850";
  context.stroke();
  context.fillStyle = "#ffdc3c";
  context.fillText(text, x + 11, y - 7);
}
