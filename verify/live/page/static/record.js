// A motion being recorded: what a registration by it still lacks, and how the recording is.
const $ = (id) => document.getElementById(id);

export class Recording {
  constructor() {
    this.finished = false;
    this.ends = null;
  }

  begin(facts) {
    this.finished = false;
    this.ends = facts.ends_s;
  }

  now({ title, goals, finished }) {
    this.finished = finished;
    this.complete = goals.length > 0 && goals.every((goal) => goal.reached);
    $("needs-title").textContent = title.replaceAll("`", "");
    $("needed").replaceChildren(
      ...goals.map(({ name, share, reached, words }) => {
        const item = made("li", "", reached ? "reached" : "");
        const meter = made("div", "", "meter");
        const full = made("i");
        full.style.width = `${100 * share}%`;
        meter.append(full);
        meter.setAttribute("role", "img");
        meter.setAttribute("aria-label", `${Math.floor(100 * share)} %`);
        item.append(made("span", name), meter, made("span", words));
        return item;
      }),
    );
  }

  state({ pairs, readings, dropped, recording }) {
    const left = this.ends === null ? null : Math.max(this.ends - Date.now() / 1000, 0);
    const time = left === null || this.finished ? "" : left < 90 ? `, ${Math.round(left)} s left` : `, ${Math.round(left / 60)} min left`;
    const words = `${pairs} pairs, ${readings} readings${this.finished ? ", finished" : time}`;
    const pill = $("recorded");
    pill.className = `pill ${this.complete ? "well" : "waits"}`;
    if (pill.textContent !== words) pill.textContent = words;
    const lost = Object.entries(dropped).map(([reason, count]) => `${reason} (${count})`);
    const figures = { Dropped: lost.join("; ") || "none", Recording: recording || "–" };
    $("figures").replaceChildren(...Object.entries(figures).flatMap(([name, value]) => [made("dt", name), made("dd", value)]));
  }
}

function made(name, text = "", kind = "") {
  const element = document.createElement(name);
  element.textContent = text;
  if (kind) element.className = kind;
  return element;
}
