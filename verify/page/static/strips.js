// Joint errors scrolling, each with its 2u band, its tolerance, and how near an alarm is.
const SPAN = 30; // s shown
const KEPT = 60; // s remembered
const SMALLEST = 0.05; // degrees, half the height: less would show noise as drama

export class Strips {
  constructor(root) {
    this.root = root;
    this.rows = [];
    this.strips = [];
    this.tolerance = null;
  }

  begin(joints, tolerance) {
    this.rows = [];
    this.tolerance = tolerance;
    this.strips = [];
    this.root.replaceChildren();
    for (let j = 0; j < joints; j++) this.strips.push(this.make(j));
  }

  make(j) {
    const strip = document.createElement("div");
    strip.className = "strip";
    const told = document.createElement("div");
    told.className = "told";
    const name = document.createElement("button");
    name.type = "button";
    name.className = "name";
    name.textContent = `Joint ${j + 1}`;
    name.title = `${j + 1}: taller, and back`;
    name.setAttribute("aria-expanded", "false");
    name.addEventListener("click", () => this.toggle(j));
    const value = document.createElement("div");
    value.className = "value";
    value.textContent = "–";
    const meter = document.createElement("div");
    meter.className = "meter";
    meter.title = "How near the sum is to an alarm";
    const fill = document.createElement("i");
    meter.append(fill);
    told.append(name, value, meter);
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Error of joint ${j + 1} over the last ${SPAN} seconds`);
    strip.append(told, canvas);
    this.root.append(strip);
    return { strip, name, value, fill, canvas };
  }

  toggle(j) {
    const part = this.strips[j];
    if (!part) return;
    const tall = part.strip.classList.toggle("tall");
    part.name.setAttribute("aria-expanded", String(tall));
  }

  add(rows) {
    this.rows.push(...rows);
    const last = this.rows.at(-1);
    if (!last) return;
    while (this.rows.length && this.rows[0].t_s < last.t_s - KEPT) this.rows.shift();
  }

  mark(joints) {
    this.strips.forEach((part, j) => part.strip.classList.toggle("alarmed", joints.has(j + 1)));
  }

  meters(statistic) {
    (statistic ?? []).forEach((share, j) => {
      const fill = this.strips[j]?.fill;
      if (!fill) return;
      fill.style.width = `${Math.min(share, 1) * 100}%`;
      fill.classList.toggle("high", share > 0.7);
    });
  }

  draw(colours) {
    const last = this.rows.at(-1);
    if (!last) return;
    const end = last.t_s;
    const shown = this.rows.filter((row) => row.t_s >= end - SPAN);
    this.strips.forEach((part, j) => this.drawOne(part, j, shown, end, last, colours));
  }

  drawOne(part, j, rows, end, last, colours) {
    const told = rows.filter((row) => row.error_deg[j] !== null && row.u_deg[j] !== null);
    this.say(part, j, last);
    const tolerance = this.tolerance ? this.tolerance[j] : null;
    const { context, width, height } = sized(part.canvas);
    context.clearRect(0, 0, width, height);
    const sizes = told.map((row) => Math.abs(row.error_deg[j]) + 2 * row.u_deg[j]).sort((a, b) => a - b);
    let half = Math.max(SMALLEST, 1.1 * (sizes[Math.floor(sizes.length * 0.98)] ?? 0));
    if (tolerance !== null && tolerance < 6 * half) half = Math.max(half, 1.15 * tolerance);
    half = rounded(half);
    const x = (t) => width * (1 - (end - t) / SPAN);
    const y = (v) => height / 2 - (v / half) * (height / 2 - 8);
    this.frame(context, width, height, half, y, colours);
    if (tolerance !== null && tolerance <= half) {
      context.strokeStyle = colours.tolerance;
      context.setLineDash([2, 3]);
      for (const v of [tolerance, -tolerance]) line(context, 0, y(v), width, y(v));
      context.setLineDash([]);
    }
    for (const run of runs(told)) {
      context.fillStyle = colours.band;
      context.beginPath();
      run.forEach((row) => context.lineTo(x(row.t_s), y(row.error_deg[j] + 2 * row.u_deg[j])));
      run.toReversed().forEach((row) => context.lineTo(x(row.t_s), y(row.error_deg[j] - 2 * row.u_deg[j])));
      context.fill();
      context.strokeStyle = colours.measured;
      context.lineWidth = 1.3;
      context.beginPath();
      run.forEach((row) => context.lineTo(x(row.t_s), y(row.error_deg[j])));
      context.stroke();
    }
  }

  frame(context, width, height, half, y, colours) {
    context.lineWidth = 1;
    context.strokeStyle = colours.grid;
    for (let s = 0; s <= SPAN; s += 5) {
      const at = Math.round(width * (s / SPAN)) + 0.5;
      line(context, at, 0, at, height);
    }
    context.strokeStyle = colours.muted;
    line(context, 0, y(0), width, y(0));
    context.fillStyle = colours.muted;
    context.font = "11px system-ui, sans-serif";
    context.fillText(`+${half}°`, 3, 11);
    context.fillText(`−${half}°`, 3, height - 3);
  }

  say(part, j, last) {
    const error = last.error_deg[j];
    const u = last.u_deg[j];
    const bold = document.createElement("b");
    bold.textContent = error === null ? "–" : `${signed(error)}°`;
    const rest = u === null ? ` ${last.status === "measured" ? "not told" : last.status.replaceAll("_", " ")}` : ` ± ${u.toFixed(3)}°`;
    part.value.replaceChildren(bold, rest);
  }
}

export function sized(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  const wanted = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== wanted[0] || canvas.height !== wanted[1]) [canvas.width, canvas.height] = wanted;
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

function signed(value) {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(3)}`;
}

function rounded(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return Number(([1, 1.5, 2, 3, 5, 7, 10].find((m) => m * power >= value) * power).toPrecision(2));
}

function* runs(rows) {
  let run = [];
  for (const row of rows) {
    if (run.length && row.t_s - run.at(-1).t_s > 0.5) {
      yield run;
      run = [];
    }
    run.push(row);
  }
  if (run.length) yield run;
}
