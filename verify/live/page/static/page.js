// The live page. All text comes from outside and goes in as text: no markup is ever made of it.
import { Boards } from "./boards.js";
import { Grab } from "./grab.js";
import { PictureView } from "./pictures.js";
import { Recording } from "./record.js";
import { Scene } from "./scene.js";
import { Strips } from "./strips.js";

const RETRY_MS = [300, 600, 1200, 2500]; // then always the last
const STALE_MS = 3000; // without a word on an open line
const BANNER_S = 60; // an event that long ago is history

const $ = (id) => document.getElementById(id);
const strips = new Strips($("strips"));
const scene = new Scene($("scene"));
const boards = new Boards(say);
const pictures = [new PictureView($("left"), $("left-said"), "Left"), new PictureView($("right"), $("right-said"), "Right")];
const grab = new Grab(say, pictures);
const recording = new Recording();
const textDecoder = new TextDecoder();
let colours = {};
let paused = false;
let hello = null;
let line = null; // to the server
let attempts = 0;
let heard = 0;
let changed = true;

/** Send a line to the program, which alone decides what it does; false where it cannot be sent. */
function say(text) {
  if (line?.readyState !== WebSocket.OPEN) return false;
  line.send(text);
  return true;
}

function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.binaryType = "arraybuffer";
  line = socket;
  heard = Date.now();
  const watch = setInterval(() => {
    if (Date.now() - heard > STALE_MS && socket.readyState === WebSocket.OPEN) socket.close();
  }, 500);
  socket.onopen = () => {
    attempts = 0;
    connection("well", "live");
    grab.connected(true);
  };
  socket.onmessage = (event) => {
    heard = Date.now();
    if (typeof event.data === "string") take(JSON.parse(event.data));
    else if (!paused) picture(event.data);
  };
  socket.onclose = () => {
    clearInterval(watch);
    grab.connected(false);
    if (boards.finished || grab.finished || recording.finished) connection("waits", "finished");
    else connection("ill", "connection lost, trying again");
    setTimeout(connect, RETRY_MS[Math.min(attempts++, RETRY_MS.length - 1)]);
  };
}

function connection(kind, text) {
  const pill = $("connection");
  pill.className = `pill ${paused && kind === "well" ? "waits" : kind}`;
  pill.textContent = paused && kind === "well" ? "paused" : text;
}

function picture(buffer) {
  const view = new DataView(buffer);
  const length = view.getUint32(1);
  const found = JSON.parse(textDecoder.decode(new Uint8Array(buffer, 5, length)));
  pictures[view.getUint8(0)].show(found, buffer.slice(5 + length), boards.cells(view.getUint8(0)));
}

const takers = {
  hello(message) {
    hello = message;
    document.title = `${message.title} · verify`;
    $("title").textContent = message.title;
    $("description").textContent = message.description;
    for (const part of document.querySelectorAll("[data-modes]"))
      part.hidden = !part.dataset.modes.split(" ").includes(message.mode);
    for (const view of pictures) view.names = message.leds ?? [];
    if (paused && message.mode !== "run") pause();
    document.body.dataset.mode = message.mode;
    if (message.mode === "calibrate") return boards.begin(message);
    if (message.mode === "record") return recording.begin(message);
    if (message.mode === "grab") return grab.begin(message), sceneOf(message, "Arm and target", "Arm, target and planned way");
    sceneOf(message, "Arm and LEDs", "Arm and LEDs as measured and by the encoders");
    strips.begin(message.joints, message.tolerance_deg);
    $("last-joint").textContent = Math.min(message.joints, 9);
  },
  rows(message) {
    if (hello.mode === "calibrate") return boards.now(message.rows.at(-1));
    if (hello.mode === "record") return recording.now(message.rows.at(-1));
    if (hello.mode === "grab") return grab.now(message.rows.at(-1)), scene.show(grab.scene());
    if (paused && !message.past) return;
    strips.add(message.rows);
    const last = message.rows.at(-1);
    if (last?.scene) {
      const { measured, encoder, cameras } = last.scene;
      scene.show({ measured, encoder, cameras });
      strips.meters(last.scene.statistic);
    }
    $("figures").dataset.clock = last?.clock ? clockWords(last) : "";
  },
  state: (message) => (showState(message), hello.mode === "run" && showOverall()),
  alarms: showAlarms,
};

function sceneOf(facts, title, seen) {
  scene.begin(facts);
  $("scene-title").textContent = title;
  $("scene").setAttribute("aria-label", `${seen}; arrow keys turn the view, plus and minus bring it nearer`);
}

function take(message) {
  takers[message.type]?.(message);
  changed = true;
}

function showState(state) {
  $("devices").replaceChildren(
    ...state.devices.map((device) => {
      const item = element("li", "", device.well ? "" : "ill");
      item.append(element("span", device.name), element("span", device.sentence));
      return item;
    }),
  );
  if (hello.mode === "calibrate") return boards.state(state);
  if (hello.mode === "grab") return grab.state(state);
  if (hello.mode === "record") return recording.state(state);
  const dropped = Object.entries(state.dropped).map(([reason, count]) => `${reason} (${count})`);
  const latency = state.latency_p50_ms === null ? "–" : `median ${state.latency_p50_ms} ms, 99 % within ${state.latency_p99_ms} ms`;
  const figures = {
    "Pairs": `${state.measured} of ${state.pairs} measured, ${state.rate_hz.toFixed(1)} per second`,
    "Dropped": dropped.join("; ") || "none",
    "Latency": latency,
    "Clock": $("figures").dataset.clock || "–",
    "Recording": state.recording || "–",
  };
  $("figures").replaceChildren(...Object.entries(figures).flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
}

function showOverall() {
  const [kind, words] = strips.overall();
  const left = hello.ends_s === null ? null : Math.max(hello.ends_s - Date.now() / 1000, 0);
  const time = left === null ? "" : left < 90 ? `, ${Math.round(left)} s left` : `, ${Math.round(left / 60)} min left`;
  const pill = $("overall");
  pill.className = `pill ${kind}`;
  if (pill.textContent !== words + time) pill.textContent = words + time;
}

function showAlarms({ alarms }) {
  if (hello?.mode !== "run") return;
  const list = $("alarms");
  const standing = alarms.filter((alarm) => alarm.ended_s === null && alarm.kind !== "change");
  const recent = alarms.filter((alarm) => alarm.kind === "change" && Date.now() / 1000 - alarm.began_s < BANNER_S);
  const urgent = [...standing, ...recent].sort((a, b) => b.began_s - a.began_s);
  const banner = $("banner");
  banner.hidden = urgent.length === 0;
  const text = urgent.length ? urgent[0].text + (urgent.length > 1 ? ` (and ${urgent.length - 1} more)` : "") : "";
  if (banner.textContent !== text) banner.textContent = text; // said aloud once, not twice a second
  strips.mark(new Set(urgent.filter((alarm) => alarm.joint !== null).map((alarm) => alarm.joint)));
  const key = JSON.stringify(alarms.map((alarm) => [alarm.alarm, alarm.ended_s, alarm.text]));
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  if (!alarms.length) {
    list.replaceChildren(element("li", `None so far. False alarms expected: ${hello?.false_alarms_per_hour ?? "?"} per hour.`, "none"));
    return;
  }
  list.replaceChildren(...alarms.map(alarmItem));
}

function alarmItem(alarm) {
  const stands = alarm.ended_s === null && alarm.kind !== "change";
  const item = element("li", "", `${alarm.kind} ${stands ? "stands" : ""}`);
  const time = element("time", clock(alarm.began_s));
  time.dateTime = new Date(alarm.began_s * 1000).toISOString();
  item.append(time, element("span", alarm.text));
  if (alarm.ended_s !== null) item.append(element("span", ` Over at ${clock(alarm.ended_s)}.`, "over"));
  return item;
}

function clockWords({ clock, offset_s, offset_u_s }) {
  const known = offset_u_s === null ? "" : ` ± ${(2000 * offset_u_s).toFixed(2)} ms (k = 2)`;
  return `${clock}, offset ${(1000 * offset_s).toFixed(2).replace("-", "−")}${known || " ms"}`;
}

function clock(seconds) {
  return new Date(seconds * 1000).toLocaleTimeString([], { hour12: false });
}

function element(name, text = "", kind = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  const style = getComputedStyle(document.documentElement);
  for (const key of ["ink", "muted", "grid", "paper", "measured", "encoder", "band", "tolerance", "ill"])
    colours[key] = style.getPropertyValue(`--${key}`).trim();
  scene.dirty = changed = true;
}

function otherTheme() {
  const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  localStorage.setItem("theme", next);
  theme(next);
}

function pause() {
  paused = !paused;
  $("pause").setAttribute("aria-pressed", String(paused));
  $("pause").textContent = paused ? "Resume" : "Pause";
  connection("well", "live");
}

function draw() {
  if (changed && !document.hidden) {
    changed = false;
    strips.draw(colours);
    boards.draw(colours);
  }
  if (scene.dirty && !document.hidden) scene.draw(colours);
  requestAnimationFrame(draw);
}

$("pause").addEventListener("click", pause);
$("theme").addEventListener("click", otherTheme);
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (hello?.mode === "grab" && grab.key(event, true)) return event.preventDefault();
  const onButton = event.target instanceof HTMLButtonElement;
  if (hello?.mode === "calibrate" && boards.key(event.key, onButton)) return event.preventDefault();
  if (event.key === " " && !onButton && hello?.mode === "run") pause();
  else if (event.key.toLowerCase() === "t") otherTheme();
  else if (/^[1-9]$/.test(event.key)) strips.toggle(Number(event.key) - 1), (changed = true);
  else return;
  if (!onButton || event.key !== " ") event.preventDefault();
});
document.addEventListener("keyup", (event) => {
  if (hello?.mode === "grab" && grab.key(event, false)) event.preventDefault(); // a button would be pressed by Space now
});
const dark = matchMedia("(prefers-color-scheme: dark)");
dark.addEventListener("change", () => localStorage.getItem("theme") || theme(dark.matches ? "dark" : "light"));
addEventListener("resize", () => (scene.dirty = changed = true));
theme(localStorage.getItem("theme") ?? (dark.matches ? "dark" : "light"));
connect();
draw();
