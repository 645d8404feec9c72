// Pictures of a board being taken: what is covered, what is missing, and the two things to ask for.
const { uPlot } = window;

const TILT = 60; // degrees either way
const FONT = "11px system-ui, sans-serif";
const SURE_MS = 4000; // within which finishing is pressed again
const KINDS = { searching: "waits", alike: "waits", moving: "waits", ready: "well" };

const $ = (id) => document.getElementById(id);

export class Boards {
  /** `ask` sends a word to the program. */
  constructor(ask) {
    this.ask = ask;
    this.finished = false;
    this.coverage = [];
    this.newest = null;
    this.plots = [];
    this.colours = {};
    this.sureUntil = 0;
    $("take").addEventListener("click", () => this.ask("take"));
    $("finish").addEventListener("click", () => this.finish());
  }

  begin(facts) {
    this.still = facts.still_px;
    this.finished = false;
    for (const { tilts, distances } of this.plots) [tilts, distances].forEach((plot) => plot.destroy());
    const charts = [...document.querySelectorAll("#coverage figure")];
    this.plots = charts.map((figure) => ({ tilts: this.tilts(figure.querySelector(".tilts")), distances: this.distances(figure.querySelector(".distances")) }));
  }

  /** Counts of corners over a camera's picture. */
  cells(side) {
    return this.coverage[side]?.cells ?? [];
  }

  key(key, onButton) {
    if (key === " " && !onButton) this.ask("take");
    else if (key.toLowerCase() === "f") this.finish();
    else return false;
    return true;
  }

  /** A slip must not end it: only the second press within a few seconds does. */
  finish() {
    if (Date.now() < this.sureUntil) return this.ask("finish");
    this.sureUntil = Date.now() + SURE_MS;
    $("finish").textContent = `Finish with ${this.newest?.pairs ?? 0} pairs? Again`;
    setTimeout(() => ($("finish").textContent = "Finish"), SURE_MS);
  }

  now(row) {
    this.newest = row;
    this.finished = row.finished;
    $("pairs").textContent = row.pairs ? `${row.pairs} taken` : "none yet";
    const words = $("words");
    if (words.textContent !== row.words) words.textContent = row.words;
    words.className = `pill ${KINDS[row.status]}`;
    $("last").textContent = row.last;
    const share = row.motion_px === null ? 1 : Math.min(row.motion_px / (4 * this.still), 1);
    $("motion").style.width = `${100 * share}%`;
    $("motion").classList.toggle("high", row.motion_px === null || row.motion_px > this.still);
    $("take").disabled = $("finish").disabled = row.finished;
  }

  state({ coverage, goals }) {
    this.coverage = coverage;
    const items = goals.map(({ name, reached, words }) => {
      const item = document.createElement("li");
      item.className = reached ? "" : "open";
      for (const text of [name, words]) item.append(Object.assign(document.createElement("span"), { textContent: text }));
      return item;
    });
    $("goals").replaceChildren(...items);
  }

  draw(colours) {
    this.colours = colours;
    this.plots.forEach((plots, side) => {
      const taken = this.coverage[side]?.placements ?? [];
      const now = this.newest?.now[side] ?? null;
      spread(plots.tilts, taken, now, (s) => [s.about_vertical_deg, s.about_horizontal_deg]);
      spread(plots.distances, taken, now, (s) => [s.distance_m, 0]);
    });
  }

  tilts(chart) {
    const degrees = (_, splits) => splits.map((v) => `${v < 0 ? "−" : ""}${Math.abs(v)}°`);
    const range = () => [-TILT, TILT];
    return this.scatter(chart, { x: { time: false, range }, y: { range } }, [
      { values: degrees, incrs: [20, 30, 60], space: 34, label: "right edge nearer →", labelSize: 16, size: 24 },
      { values: degrees, incrs: [20, 30, 60], space: 24, label: "upper edge nearer →", labelSize: 16, size: 40 },
    ]);
  }

  distances(chart) {
    const range = (_, low, high) => (low === null ? [0.5, 1.5] : [0.8 * low, 1.2 * high]);
    const metres = (_, splits) => splits.map((v) => `${Number(v.toFixed(2))} m`);
    return this.scatter(chart, { x: { time: false, range }, y: { range: () => [-1, 1] } }, [{ values: metres, size: 24 }, { show: false }]);
  }

  scatter(chart, scales, axes) {
    const colour = (key) => () => this.colours[key];
    const usual = { stroke: colour("muted"), font: FONT, labelFont: FONT, ticks: { show: false }, grid: { stroke: colour("grid"), width: 1 } };
    const points = (stroke, fill, size, width) => ({ paths: () => null, points: { show: true, size, width, stroke: colour(stroke), fill: colour(fill) } });
    const options = {
      width: chart.clientWidth,
      height: chart.clientHeight,
      legend: { show: false },
      cursor: { show: false },
      scales,
      padding: [8, 16, 0, axes[1].show === false ? 16 : 0],
      axes: axes.map((axis) => ({ ...usual, ...axis })),
      series: [{}, points("measured", "measured", 7, 0), points("encoder", "paper", 12, 2.5)],
    };
    return new uPlot(options, [[], [], []], chart);
  }
}

/** Put points into a plot: of the pairs taken, and of the board now. uPlot wants x to rise. */
function spread(plot, taken, now, place) {
  const points = taken.map((s) => [...place(s), null]);
  if (now) {
    const [x, y] = place(now);
    points.push([x, null, y]);
  }
  points.sort((a, b) => a[0] - b[0]);
  const { clientWidth: width, clientHeight: height } = plot.root.parentElement;
  if (width !== plot.width || height !== plot.height) plot.setSize({ width, height });
  plot.setData([0, 1, 2].map((i) => points.map((p) => p[i])));
}
