// What is shown beside the map: a run at work, told by a stream, or a finished map.

import { Space } from "./space.js";
import { plot, strip } from "./plots.js";

// The server says something at least every two seconds.
const SILENCE_MS = 10000, RETRY_MS = 1000;
const NEWS = 1, SPLATS = 2, PICTURE = 3, END = 5;
const byId = (id) => document.getElementById(id);
const number = (value, digits = 0) =>
  value === null || value === undefined ? "–" : value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });

function facts(list, pairs) {
  list.replaceChildren(...pairs.flatMap(([name, value]) => {
    const [term, text] = [document.createElement("dt"), document.createElement("dd")];
    term.textContent = name;
    text.textContent = value;
    return [term, text];
  }));
}

function trouble(text) {
  byId("trouble").textContent = text;
  byId("trouble").hidden = !text;
}

const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const sceneText = await (await fetch("scene.json")).text(), scene = JSON.parse(sceneText);
document.title = `${scene.title} – fgs-slam`;
byId("title").textContent = scene.title;
if (scene.half_extent) document.body.style.setProperty("--aspect", scene.half_extent[0] / scene.half_extent[1]);
let space;
try {
  space = new Space(byId("view"), scene.half_extent);
} catch (error) {
  trouble(`This browser shows no 3D graphics (WebGL 2): ${error.message}`);
  throw error;
}
byId("follow").onclick = () => space.follow(!space.follows);
byId("overview").onclick = () => space.overview();
byId("fly").onclick = () => space.fly();
byId("show-path").onchange = (event) => space.show(["path", "loop"], event.target.checked);
byId("show-keyframes").onchange = (event) => space.show(["tracking", "mapping"], event.target.checked);
space.onFollow = (isOn) => byId("follow").classList.toggle("on", isOn);
space.onPick = (keyframe) => space.lookFrom(keyframe);

if (scene.live) showRun(); else showMap();

/** A run at work. */
function showRun() {
  for (const id of ["live", "plots", "stop"]) byId(id).hidden = false;
  space.follow(true);
  const nothing = () => ({ frames: [], keyframes: new Map(), loops: [], renders: [], phase: {} });
  const run = nothing();
  byId("stop").onclick = async () => {
    byId("stop").disabled = true;
    byId("stop").textContent = "Stopping";
    await fetch("stop", { method: "POST" });
  };
  let isStale = false;
  setInterval(() => { if (isStale) { isStale = false; draw(run); } }, 250);
  window.addEventListener("resize", () => { isStale = true; });
  const messages = {
    [NEWS]: (bytes) => { hear(run, JSON.parse(new TextDecoder().decode(bytes))); isStale = true; },
    [SPLATS]: (bytes) => {
      const header = new DataView(bytes.buffer, bytes.byteOffset, 8);
      space.splats.put(header.getUint32(0, true), header.getUint32(4, true), bytes.subarray(8));
    },
    [PICTURE]: (bytes) => {
      const image = byId(`picture-${bytes[0]}`), old = image.src;
      image.src = URL.createObjectURL(new Blob([bytes.subarray(1)], { type: "image/jpeg" }));
      image.onload = () => { if (old) URL.revokeObjectURL(old); };
    },
    [END]: () => { run.isOver = true; },
  };
  // Whoever connects is told everything from the beginning.
  follow(() => { Object.assign(run, nothing()); setBroken(false); }, messages, () => run.isOver, () => setBroken(true))
    .then(() => { byId("stop").hidden = true; draw(run); });
}

function setBroken(isBroken) {
  byId("phase").classList.toggle("broken", isBroken);
  if (isBroken) byId("phase").textContent = "connection lost, trying again";
  byId("stop").hidden = isBroken;
}

/** Reads the stream until the run is over; looks for the server again whenever the connection breaks. */
async function follow(begin, messages, isOver, onBreak) {
  for (;;) {
    await read(begin, messages).catch(() => {});
    if (isOver()) return;
    onBreak();
    do await sleep(RETRY_MS); while (!(await isBack()));
  }
}

/** Whether the server answers. If it shows another run by now, or a finished map, the page is loaded anew. */
async function isBack() {
  try {
    const response = await fetch("scene.json", { signal: AbortSignal.timeout(SILENCE_MS) });
    if (!response.ok) return false;
    if ((await response.text()) !== sceneText) location.reload();
    return true;
  } catch {
    return false;
  }
}

/** Takes the stream's messages as they come: a length, what it is, the content. A connection over which nothing
    comes is dead, which a machine that has slept is not told. */
async function read(begin, messages) {
  const silence = new AbortController();
  let watch;
  const listen = () => { clearTimeout(watch); watch = setTimeout(() => silence.abort(), SILENCE_MS); };
  listen();
  const response = await fetch("stream", { signal: silence.signal });
  if (!response.ok) throw new Error(response.statusText);
  const reader = response.body.getReader();
  let rest = null;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return clearTimeout(watch);
    listen();
    if (!rest) { begin(); rest = new Uint8Array(0); }
    const bytes = new Uint8Array(rest.length + value.length);
    bytes.set(rest);
    bytes.set(value, rest.length);
    let at = 0;
    while (bytes.length - at >= 5) {
      const length = new DataView(bytes.buffer).getUint32(at, true);
      if (bytes.length - at - 5 < length) break;
      messages[bytes[at + 4]]?.(bytes.slice(at + 5, at + 5 + length));
      at += 5 + length;
    }
    rest = bytes.slice(at);
  }
}

function hear(run, news) {
  run.frames.push(...news.frames);
  run.renders.push(...news.renders);
  if (news.keyframes) run.keyframes = new Map(news.keyframes.map((keyframe) => [keyframe.id, keyframe]));
  if (news.loops) run.loops = news.loops;
  if (news.phase) run.phase = news.phase;
  if (news.up) space.setUp(news.up);
  const addition = news.additions.at(-1);
  if (addition) {
    byId("detail").textContent = `${number(100 * addition.detail)} %`;
    byId("missing").textContent = `${number(100 * addition.missing)} %`;
    byId("seeds").textContent = number(addition.seeds);
    byId("added-by").textContent = number(addition.index);
  }
  if (news.keyframes || news.loops) space.setKeyframes([...run.keyframes.values()], run.loops);
  if (news.pose) space.setCurrent(news.pose);
}

/** A frame's position in the world: it is anchored to a keyframe, which may have been corrected. */
function place(run, frame) {
  const keyframe = run.keyframes.get(frame.anchor);
  if (!keyframe || !frame.position) return null;
  const [w, ...axis] = keyframe.quat, v = frame.position;
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const t = cross(axis, v).map((x) => 2 * x), u = cross(axis, t);
  return v.map((x, i) => x + w * t[i] + u[i] + keyframe.position[i]);
}

function draw(run) {
  const { frames, phase } = run, last = frames.at(-1);
  if (!byId("phase").classList.contains("broken")) byId("phase").textContent = phase.name ?? "";
  byId("phase").classList.toggle("ended", phase.name === "ended");
  if (phase.total) {
    byId("bar").firstElementChild.style.width = `${(100 * phase.done) / phase.total}%`;
    byId("count").textContent = `${number(phase.done)} / ${number(phase.total)}`;
  }
  if (phase.name === "ended") {
    byId("bar").firstElementChild.style.width = "100%";
    byId("count").textContent = phase.message;
  }
  if (!last) return;
  space.setPath(frames.map((frame) => place(run, frame)).filter(Boolean));
  const psnr = run.renders.at(-1)?.psnr_db;
  byId("psnr").textContent = psnr === undefined ? "" : `${number(psnr, 1)} dB`;
  // Frames of the last three seconds.
  const rate = frames.map((frame, i) => {
    let first = i;
    while (first > 0 && frame.secs - frames[first - 1].secs < 3) first--;
    return [frame.index, i > first ? (i - first) / Math.max(frame.secs - frames[first].secs, 1e-3) : null];
  });
  plot(byId("plot-fps"), "frames per second", rate.filter(([, value]) => value !== null), "fps", { digits: 1 });
  const of = (key, factor = 1) => frames.filter((frame) => frame[key] !== null).map((frame) => [frame.index, factor * frame[key]]);
  plot(byId("plot-tracking"), "tracking", of("tracking_ms"), "ms", { digits: 1, stroke: "--good" });
  plot(byId("plot-gaussians"), "gaussians", of("gaussians"), "", { digits: 0, stroke: "--mapping" });
  const renders = run.renders.map(({ index, psnr_db }) => [index, psnr_db]);
  plot(byId("plot-psnr"), "PSNR of the render", renders, "dB", { digits: 1, fromZero: false, stroke: "--warm" });
  strip(byId("strip"), frames);
  const counts = (status) => frames.filter((frame) => frame.status === status).length;
  facts(byId("facts"), [
    ["frame", number(last.index)], ["verdict", last.status],
    ["keyframes", number(run.keyframes.size)], ["loops closed", number(run.loops.length)],
    ["residual", last.residual_mm === null ? "–" : `${number(last.residual_mm, 1)} mm`],
    ["inliers", last.points ? `${number((100 * last.inliers) / last.points)} %` : "–"],
    ["steps", number(last.steps)], ["time", `${number(last.secs, 0)} s`],
    ["weak", number(counts("weak"))], ["lost", number(counts("lost"))],
  ]);
}

/** A finished map. */
async function showMap() {
  byId("finished").hidden = false;
  byId("bar").style.visibility = "hidden";
  byId("follow").hidden = true;
  byId("fly").hidden = scene.keyframes.length < 2;
  byId("count").textContent = `${number(scene.gaussians)} gaussians`;
  facts(byId("numbers"), scene.numbers);
  space.setUp(scene.up);
  space.setPath(scene.path);
  space.setKeyframes(scene.keyframes);
  const first = scene.keyframes[0] ?? { quat: [1, 0, 0, 0], position: [0, 0, 0] };
  space.lookOver(first);
  const cards = scene.keyframes.filter((keyframe) => keyframe.render).map((keyframe) => {
    const card = document.createElement("div");
    card.className = keyframe.input ? "card" : "card single";
    for (const [name, label] of [["input", `frame ${keyframe.index}`], ["render", "render"]]) {
      if (!keyframe[name]) continue;
      const figure = document.createElement("figure"), image = new Image(), caption = document.createElement("figcaption");
      image.loading = "lazy";
      image.src = keyframe[name];
      caption.textContent = keyframe.input ? label : `render at frame ${keyframe.index}`;
      figure.append(image, caption);
      card.append(figure);
    }
    card.onclick = () => space.onPick(keyframe);
    return [keyframe, card];
  });
  byId("gallery").replaceChildren(...cards.map(([, card]) => card));
  byId("gallery-title").hidden = cards.length === 0;
  const look = space.onPick;
  space.onPick = (keyframe) => {
    look(keyframe);
    for (const [other, card] of cards) {
      card.classList.toggle("on", other === keyframe);
      if (other === keyframe) card.scrollIntoView({ block: "nearest" });
    }
  };
  byId("phase").textContent = "loading";
  const response = await fetch("map.splat");
  if (!response.ok) return trouble(`The map cannot be loaded: ${response.statusText}`);
  const bytes = new Uint8Array(await response.arrayBuffer());
  space.splats.put(bytes.length / 32, 0, bytes);
  byId("phase").textContent = "";
}
