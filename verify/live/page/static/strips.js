// Joint errors scrolling, each with its 2u band, its tolerance, and how near an alarm is.
// uPlot draws them; it is a plain script, loaded before this module.
const { uPlot } = window;

const SPAN = 30; // s shown
const KEPT = 60; // s remembered
const GAP = 0.5; // s without a row: the line breaks
const STATE_SPAN = 1; // s that the overall state rests on
const SMALLEST = 0.05; // degrees, half the height: less would show noise as drama
const LABEL = 14; // px from one label of the scale to the next
const PADDING = 6; // px above and below the curves
const TIMES = 22; // px, height of the labels of time
const FONT = "11px system-ui, sans-serif";

export class Strips {
  constructor(root) {
    this.root = root;
    this.rows = [];
    this.shown = [];
    this.strips = [];
    this.tolerance = null;
    this.colours = {};
  }

  begin(joints, tolerance) {
    for (const { plot } of this.strips) plot.destroy();
    this.rows = [];
    this.shown = [];
    this.statistic = [];
    this.tolerance = tolerance;
    this.root.replaceChildren();
    this.root.style.setProperty("--joints", joints); // by which a large window is shared out
    this.strips = Array.from({ length: joints }, (_, j) => this.make(j, j === joints - 1));
  }

  make(j, last) {
    const strip = element("div", "strip");
    const told = element("div", "told");
    const name = element("button", "name");
    name.type = "button";
    name.textContent = `Joint ${j + 1}`;
    name.title = `${j + 1}: taller, and back`;
    name.setAttribute("aria-expanded", "false");
    name.addEventListener("click", () => this.toggle(j));
    const value = element("div", "value");
    value.textContent = "–";
    const meter = element("div", "meter");
    const fill = element("i");
    meter.append(fill);
    const level = element("small", "level");
    told.append(name, value, meter, level);
    const chart = element("div", "chart");
    chart.setAttribute("role", "img");
    chart.setAttribute("aria-label", `Error of joint ${j + 1} over the last ${SPAN} seconds`);
    strip.append(told, chart);
    this.root.append(strip);
    const part = { strip, name, value, fill, level, chart, last, half: SMALLEST, mark: SMALLEST / 2 };
    part.plot = new uPlot(this.options(part, j), [[], [], [], [], [], [], []], chart);
    return part;
  }

  options(part, j) {
    const colour = (key) => () => this.colours[key];
    const line = (key, width, dash) => ({ stroke: colour(key), width, dash, points: { show: false } });
    const axis = { stroke: colour("muted"), font: FONT, ticks: { show: false }, grid: { stroke: colour("grid"), width: 1 } };
    return {
      ...size(part.chart),
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { setScale: false, x: false }, sync: { key: "joints" } },
      scales: { x: { time: false, range: () => [-SPAN, 0] }, y: { range: () => [-part.half, part.half] } },
      series: [{}, line("band", 0), line("band", 0), line("tolerance", 1.5, [2, 3]), line("tolerance", 1.5, [2, 3]), line("measured", 1.3), line("ill", 2)],
      bands: [{ series: [1, 2], fill: colour("band") }],
      padding: [PADDING, 14, PADDING, 0],
      axes: [
        { ...axis, size: () => (timed(part) ? TIMES : 0), gap: 4, space: 40, incrs: [5, 10], values: (_, splits) => splits.map((s) => (!timed(part) ? "" : s ? `−${-s} s` : "now")) },
        { ...axis, size: 50, gap: 6, space: 20, splits: () => [-part.mark, 0, part.mark], values: (_, splits) => splits.map((v) => `${v > 0 ? "+" : v < 0 ? "−" : ""}${Number(Math.abs(v).toFixed(5))}°`) },
      ],
      hooks: { setCursor: [() => this.say(part, j)] },
    };
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
    this.meters(this.statistic);
  }

  /** How near an alarm each joint is; in alarm it is full, whatever is still added up. */
  meters(statistic) {
    this.statistic = statistic ?? [];
    this.strips.forEach(({ strip, fill, level }, j) => {
      if (this.statistic[j] === undefined) return;
      const alarmed = strip.classList.contains("alarmed");
      const share = alarmed ? 1 : Math.min(this.statistic[j], 1);
      fill.style.width = `${share * 100}%`;
      fill.classList.toggle("high", share > 0.7);
      const tolerance = this.tolerance?.[j] ?? null;
      const limit = tolerance === null ? "" : `tolerance ±${tolerance}°, `;
      level.textContent = `${limit}${alarmed ? "in alarm" : `alarm level ${Math.round(share * 100)} %`}`;
    });
  }

  draw(colours) {
    this.colours = colours;
    const end = this.rows.at(-1)?.t_s;
    if (end === undefined) return;
    this.shown = [...broken(this.rows.filter((row) => row.t_s >= end - SPAN))];
    const x = this.shown.map((row) => row.t_s - end);
    this.strips.forEach((part, j) => this.drawOne(part, j, x));
  }

  drawOne(part, j, x) {
    const error = this.shown.map((row) => (row.u_deg?.[j] == null ? null : row.error_deg[j]));
    const edge = (sign) => error.map((e, i) => (e === null ? null : e + sign * 2 * this.shown[i].u_deg[j]));
    const [above, below] = [edge(1), edge(-1)];
    const tolerance = this.tolerance?.[j] ?? null;
    part.half = halfHeight(above, below, tolerance);
    const level = (v) => x.map(() => v);
    const { width, height } = size(part.chart);
    if (width !== part.plot.width || height !== part.plot.height) part.plot.setSize({ width, height });
    part.mark = labelled(tolerance, part.half, height - 2 * PADDING - (timed(part) ? TIMES : 0));
    const beyond = error.map((e) => (tolerance !== null && e !== null && Math.abs(e) > tolerance ? e : null));
    part.plot.setData([x, above, below, level(tolerance), level(tolerance === null ? null : -tolerance), error, beyond]);
    this.say(part, j);
  }

  /** The value under the pointer, which all joints share; the newest where there is none. */
  say(part, j) {
    const row = this.shown[part.plot?.cursor.idx ?? this.shown.length - 1];
    if (!row?.u_deg) return;
    const [error, u] = [row.error_deg[j], row.u_deg[j]];
    const bold = element("b");
    bold.textContent = error === null ? "–" : `${signed(error)}°`;
    const rest = u === null ? ` ${row.status === "measured" ? "not determined" : row.status.replaceAll("_", " ")}` : ` ± ${(2 * u).toFixed(3)}° (k = 2)`;
    part.value.replaceChildren(bold, rest);
  }

  /** All joints over the last second against their tolerances: a kind of pill, and words. */
  overall() {
    const end = this.rows.at(-1)?.t_s;
    const recent = this.rows.filter((row) => row.t_s > end - STATE_SPAN && row.u_deg);
    if (!recent.length) return ["waits", "no pair measured"];
    const misfits = recent.filter((row) => ["outlier", "ambiguous_leds"].includes(row.status)).length;
    if (2 * misfits > recent.length) return ["ill", "not judged: most pairs fit no pose"];
    if (!this.tolerance?.some((t) => t !== null)) return ["waits", "no tolerance: errors are shown, not judged"];
    const states = this.tolerance.map((tolerance, j) => {
      const known = recent.filter((row) => row.error_deg[j] !== null && row.u_deg[j] !== null);
      if (!known.length || tolerance === null) return "open";
      const mean = (value) => known.reduce((sum, row) => sum + value(row), 0) / known.length;
      const [error, u] = [Math.abs(mean((row) => row.error_deg[j])), mean((row) => row.u_deg[j])];
      return error - 2 * u > tolerance ? "beyond" : error + 2 * u <= tolerance ? "within" : "open";
    });
    const named = (state) => states.flatMap((s, j) => (s === state ? [j + 1] : [])).join(", ");
    const same = new Set(this.tolerance).size === 1 ? `±${this.tolerance[0]}°` : "tolerance";
    if (states.includes("beyond")) return ["ill", `beyond ${same}: joint ${named("beyond")}`];
    if (states.includes("open")) return ["waits", `not decided: joint ${named("open")}; the others are within ${same}`];
    return ["well", `all joints within ${same}`];
  }
}

function element(name, kind = "") {
  const made = document.createElement(name);
  made.className = kind;
  return made;
}

/** Whether a strip has its own scale of time. */
function timed({ last, strip }) {
  return last || strip.classList.contains("tall");
}

function size(chart) {
  return { width: chart.clientWidth, height: chart.clientHeight };
}

/** Rows with an empty one where some are missing. */
function* broken(rows) {
  let before = null;
  for (const row of rows) {
    if (before !== null && row.t_s - before > GAP) yield { t_s: before + GAP / 2 };
    yield row;
    before = row.t_s;
  }
}

/** Room for all but the wildest 2 % of the band, and for the tolerance unless that is far away. */
function halfHeight(above, below, tolerance) {
  const sizes = above.flatMap((a, i) => (a === null ? [] : [Math.max(a, -below[i])])).sort((a, b) => a - b);
  let half = Math.max(SMALLEST, 1.1 * (sizes[Math.floor(sizes.length * 0.98)] ?? 0));
  if (tolerance !== null && tolerance < 6 * half) half = Math.max(half, 1.15 * tolerance);
  const power = 10 ** Math.floor(Math.log10(half)); // round, so that a plot does not breathe
  return [1, 1.5, 2, 3, 5, 7, 10].find((m) => m * power >= half) * power;
}

/** The value that is labelled beside 0: the tolerance, or half the height, where labels have room. */
function labelled(tolerance, half, height) {
  const apart = (value) => (value / half) * (height / 2) >= LABEL;
  if (tolerance !== null && tolerance < half && apart(tolerance)) return tolerance;
  return apart(half / 2) ? half / 2 : half;
}

function signed(value) {
  const size = Math.abs(value).toFixed(3);
  return Number(size) === 0 ? size : `${value < 0 ? "−" : "+"}${size}`;
}
