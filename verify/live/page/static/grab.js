// A grab: state, target, plan, and the three things to ask for: hold, grab, another target.
// What they do is decided by the program alone; this page only asks, and shows what came of it.
import { Selector } from "./grab_select.js";

const ANSWER_MS = 1000; // within which a stop must be heard of
const LATE_MS = 10000; // a stop that could not be sent for longer belongs to the past
const LOST = "This page's connection is lost. That stops nothing: use key h at the terminal, or the emergency stop.";
const UNHEARD = "STOP was not answered. Use key h at the terminal, or the emergency stop.";
const NOT_SENT = "Not sent: the connection is lost.";
const NO_SELECTION = "An object can be selected while nothing moves and the hand is up and empty.";
const SAFE = new Set(["idle", "searching", "tracking", "lifted", "released"]);

const $ = (id) => document.getElementById(id);

export class Grab {
  /** `send` sends a line to the program, and says whether it could; `views` show the cameras' pictures. */
  constructor(send, views) {
    this.send = send;
    this.row = null;
    this.way = null;
    this.stopped = null; // a press: when, and how many stops had been heard of
    this.unsent = null; // when a stop was pressed that could not be sent
    this.lost = false;
    this.answers = null;
    this.silent = 0;
    this.selector = new Selector(views, (side, box) => this.send(`select ${side} ${box.join(",")}`), (words) => say($("answer"), words));
    $("stop").addEventListener("click", () => this.stop());
    $("grab").addEventListener("click", () => this.grab());
    $("select").addEventListener("click", () => this.select());
    setInterval(() => this.warn(), 250);
  }

  get finished() {
    return Boolean(this.row?.finished);
  }

  begin(facts) {
    Object.assign(this, { facts, row: null, way: null, answers: null, stopped: null });
    $("held").textContent = facts.execute ? "" : "Nothing moves: --execute is not given. The plan is shown.";
  }

  /** The line is there, or it is gone. */
  connected(there) {
    this.lost = !there;
    if (this.row) this.offer(this.row);
    if (there && this.unsent !== null && Date.now() - this.unsent < LATE_MS) this.send("hold");
    if (there) this.unsent = null;
    this.warn();
  }

  stop() {
    this.selector.cancel();
    this.stopped = { at: Date.now(), heard: this.row?.stops ?? 0 };
    this.unsent = this.send("hold") ? null : Date.now();
    this.warn();
  }

  grab() {
    if (!$("grab").disabled) say($("answer"), this.send(`grab ${this.row.passages}`) ? "Grab sent." : NOT_SENT);
    else if (this.row) say($("answer"), this.lost ? NOT_SENT : "Grab is not possible now: nothing was sent.");
  }

  select() {
    if ($("select").disabled) return say($("answer"), this.lost ? NOT_SENT : NO_SELECTION);
    this.selector.arm(true);
    say($("answer"), "Drag a rectangle around the object in either picture; Escape ends the selection.");
  }

  /** Space and H stop whatever has the focus; Enter presses a button. */
  key(event, isDown) {
    const key = event.key.toLowerCase();
    if (key === " " || key === "h") isDown && this.stop();
    else if (!isDown) return false;
    else if (key === "g") event.repeat || this.grab();
    else if (key === "s") event.repeat || this.select();
    else return this.selector.key(event);
    return true;
  }

  now(row) {
    const before = this.row;
    this.row = row;
    const pill = $("state");
    pill.className = `pill ${row.state === "fault" || row.state.startsWith("holding") || row.state === "missed" ? "ill" : row.moving ? "moves" : SAFE.has(row.state) ? "well" : "waits"}`;
    say(pill, row.state);
    say($("reason"), row.reason || "not begun yet");
    $("elapsed").textContent = `${row.elapsed_s.toFixed(1)} s of at most ${this.facts.duration_s} s`;
    this.offer(row);
    if (before === null && row.may_choose && row.status === null) this.selector.arm(true);
    if (row.answers !== this.answers || this.finished) say($("answer"), row.finished || row.answer);
    else if (row.passages !== before?.passages) say($("answer"), ""); // it was about another state
    this.answers = row.answers;
    if (this.stopped && row.stops > this.stopped.heard) {
      this.stopped = null;
      say($("answer"), `STOP was received: ${row.state}.`);
    }
    this.target(row);
    this.warn();
  }

  offer(row) {
    const idle = this.finished || this.lost;
    $("grab").disabled = idle || row.grab_lacks !== "";
    $("select").disabled = idle || !row.may_choose;
    $("select").title = $("select").disabled ? NO_SELECTION : "S; then drag, or arrows, Shift and arrows, Enter";
    this.selector.offer(!$("select").disabled);
  }

  why(row) {
    if (this.finished) return "";
    if (row.state === "holding-operator") return this.facts.execute ? "Held. Keys at the terminal: r resumes, u opens the fingers and goes up, q ends." : "Held. Ctrl-C at the terminal ends it.";
    if (row.status === null) return "Select the object: drag a rectangle around it.";
    if (row.grab_lacks === "") return "Grab is possible: the target is tracked and a grasp is planned.";
    if (!this.facts.execute) return "";
    return row.grab_lacks === null ? `Grab is possible while following; now: ${row.state}.` : `Grab waits for: ${row.grab_lacks}.`;
  }

  target(row) {
    const known = row.position_mm !== null;
    const facts = { Target: [row.status, row.unseen_because].filter(Boolean).join(": ") };
    if (known) {
      facts["Place in the base"] = row.position_mm.map((v, i) => `${"xyz"[i]} ${v.toFixed(1)} ± ${(2 * row.standard_uncertainty_mm[i]).toFixed(1)}`).join(", ") + " mm (k = 2)";
      facts.Size = row.size_mm.every((v) => v !== null) ? `${row.size_mm[0]} mm wide, ${row.size_mm[1]} mm high` : "not known";
      facts.Speed = `${row.speed_mm_s} mm/s`;
    } else facts["Place in the base"] = "not known";
    facts.Quality = row.quality === null ? "–" : `${row.quality.toFixed(2)} of 1`;
    facts.Joints = row.q_deg === null ? "not read yet" : row.q_deg.map((v) => `${v.toFixed(1).replace(/^-0\.0$/, "0.0").replace("-", "−")}°`).join("  ");
    list($("target"), facts);
  }

  state({ plan, way, passages, silent_s }) {
    this.way = way;
    this.silent = silent_s;
    const words = $("plan-words");
    words.className = `pill ${plan === null ? "waits" : plan.kind ? "ill" : "well"}`;
    say(words, plan === null ? "none yet" : plan.kind ? `refused (${plan.kind}): ${plan.reason}` : `planned: ${plan.branch}`);
    const rejected = plan?.rejected ?? [];
    list($("plan"), plan === null || plan.kind ? {} : planned(plan));
    $("branches-section").hidden = !rejected.length;
    list($("branches"), Object.fromEntries(rejected.map(({ branch, reason }) => [branch, reason])));
    $("passages").replaceChildren(
      ...passages.map(({ elapsed_s, state, reason }) => {
        const item = document.createElement("li");
        item.append(part("time", `${elapsed_s.toFixed(2)} s`), part("b", state), part("span", reason));
        return item;
      }),
    );
    this.warn();
  }

  /** What a person must know at once, above everything. */
  warn() {
    if (!this.facts) return; // another mode's page
    const late = this.stopped && Date.now() - this.stopped.at > ANSWER_MS && !this.finished;
    const words = this.finished ? "" : this.lost ? (this.unsent !== null ? `STOP was NOT sent. ${LOST}` : LOST) : late ? UNHEARD : this.silent ? `The program has not turned for ${this.silent} s.` : "";
    $("banner").hidden = !words;
    say($("banner"), words);
    $("orders").classList.toggle("wrong", Boolean(words));
    say($("lacks"), words || (this.row ? this.why(this.row) : ""));
  }

  scene() {
    const scene = this.row?.scene ?? {};
    return { measured: { arm_mm: scene.arm_mm }, encoder: { arm_mm: this.way?.arm_mm }, way: this.way?.grip_mm, target: scene.target_mm, cameras: scene.cameras };
  }
}

function planned(plan) {
  const left = (way) => `${plan.margin[`${way}_mm`].toFixed(1)} mm, ${plan.margin[`${way}_needed_mm`].toFixed(1)} mm needed`;
  return {
    "Grip point": plan.grip_mm.map((v, i) => `${"xyz"[i]} ${v.toFixed(1)}`).join(", ") + " mm",
    "Margin sideways": left("across"),
    "Margin along": left("along"),
    "Duration": `${(plan.duration_s - plan.up_s).toFixed(1)} s to the object, ${plan.up_s.toFixed(1)} s up`,
  };
}

function list(root, facts) {
  root.replaceChildren(...Object.entries(facts).flatMap(([name, value]) => [part("dt", name), part("dd", value)]));
}

function part(name, text) {
  return Object.assign(document.createElement(name), { textContent: text });
}

/** Change a text only where it is another: what is read aloud is not repeated ten times a second. */
function say(root, text) {
  if (root.textContent !== text) root.textContent = text;
}
