// The map in space: splats, trajectory and cameras. Coordinates are the run's (metres); one group turns them
// so that up is up.

import {
  BufferGeometry, ExtSplats, Float32BufferAttribute, Group, Line, LineBasicMaterial, LineSegments, OrbitControls,
  PerspectiveCamera, Quaternion, Scene, SparkRenderer, SplatMesh, Vector3, WebGLRenderer, Color,
} from "./vendor/spark-three.min.js";

const RECORD_BYTES = 32;
const COLORS = { path: 0x4cc2ff, tracking: 0x3ecf8e, mapping: 0xb28dff, current: 0xffb020, loop: 0xff5c5c };
const FRUSTUM_M = 0.06;
const SPEED_M = 1.2; // a second

/** Splats that can be replaced piece by piece, from records of 32 bytes (the format .splat). */
class Splats {
  constructor(parent) {
    this.parent = parent;
    this.count = 0;
    this.isDirty = false;
    this.store = new ExtSplats({ maxSplats: 1 << 16 });
    this.scratch = [new Vector3(), new Vector3(), new Quaternion(), new Color()];
  }

  /** `bytes`: records of the splats from `first` on, of `count` in all. */
  put(count, first, bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const [center, scales, turn, color] = this.scratch;
    for (let at = 0, i = first; at < bytes.byteLength; at += RECORD_BYTES, i++) {
      const float = (k) => view.getFloat32(at + 4 * k, true);
      const byte = (k) => view.getUint8(at + 24 + k);
      center.set(float(0), float(1), float(2));
      scales.set(float(3), float(4), float(5));
      turn.set(byte(5) - 128, byte(6) - 128, byte(7) - 128, byte(4) - 128).normalize();
      color.r = byte(0) / 255; color.g = byte(1) / 255; color.b = byte(2) / 255;
      this.store.setSplat(i, center, scales, turn, byte(3) / 255, color);
    }
    this.count = count;
    this.isDirty = true;
  }

  /** Shows what was put. */
  show() {
    if (!this.isDirty) return false;
    this.isDirty = false;
    const arrays = this.store.extArrays;
    if (this.count === 0) return false;
    if (!this.shown || this.shown.extArrays[0] !== arrays[0]) {
      if (this.mesh) { this.parent.remove(this.mesh); this.mesh.dispose(); }
      this.shown = new ExtSplats({ extArrays: [...arrays], numSplats: this.count });
      this.mesh = new SplatMesh({ extSplats: this.shown });
      this.parent.add(this.mesh);
    } else {
      this.shown.numSplats = this.count;
      for (const texture of this.shown.textures) texture.needsUpdate = true;
      this.mesh.updateVersion();
    }
    return true;
  }

  /** A box around nearly all of them: [least, largest]. */
  extent() {
    const axes = [[], [], []], floats = new Float32Array(this.store.extArrays[0].buffer);
    const step = Math.max(1, Math.floor(this.count / 5000));
    for (let i = 0; i < this.count; i += step) for (let k = 0; k < 3; k++) axes[k].push(floats[4 * i + k]);
    const at = (values, share) => values.sort((a, b) => a - b)[Math.floor(share * (values.length - 1))] ?? 0;
    return [0.02, 0.98].map((share) => new Vector3(...axes.map((values) => at(values, share))));
  }
}

function frustumLines(keyframe, halfExtent, size) {
  const [x, y] = halfExtent.map((half) => half * size);
  const corners = [[-x, -y], [x, -y], [x, y], [-x, y]].map(([a, b]) => new Vector3(a, b, size));
  const top = new Vector3(0, -1.45 * y, size);
  const ends = [new Vector3(), ...corners, top];
  const { quat: [w, a, b, c], position } = keyframe;
  const turn = new Quaternion(a, b, c, w), place = new Vector3(...position);
  for (const end of ends) end.applyQuaternion(turn).add(place);
  const lines = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1], [1, 5], [2, 5]];
  return lines.flatMap(([i, j]) => [...ends[i].toArray(), ...ends[j].toArray()]);
}

const lineMaterial = (color, opacity = 1) =>
  new LineBasicMaterial({ color, transparent: true, opacity, depthTest: false });

export class Space {
  constructor(canvas, halfExtent) {
    this.canvas = canvas;
    this.halfExtent = halfExtent ?? [0.6, 0.45];
    this.renderer = new WebGLRenderer({ canvas, antialias: false, powerPreference: "high-performance" });
    this.fineness = Math.min(window.devicePixelRatio, 1.5);
    this.renderer.setPixelRatio(this.fineness);
    this.renderer.setClearColor(0x0c0f15);
    this.scene = new Scene();
    this.world = new Group();
    this.scene.add(this.world);
    this.spark = new SparkRenderer({ renderer: this.renderer, onDirty: () => this.redraw() });
    this.scene.add(this.spark);
    this.camera = new PerspectiveCamera(62, 1, 0.02, 200);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = true;
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", () => this.redraw());
    this.controls.addEventListener("start", () => this.release());
    this.splats = new Splats(this.world);
    this.lines = {};
    this.keys = new Set();
    this.keyframes = [];
    this.loops = [];
    this.path = [];
    this.follows = false;
    this.setUp([0, -1, 0]);
    this.lookOver({ quat: [1, 0, 0, 0], position: [0, 0, 0] });
    canvas.tabIndex = 0;
    window.addEventListener("keydown", (event) => this.key(event, true));
    window.addEventListener("keyup", (event) => this.key(event, false));
    window.addEventListener("blur", () => this.keys.clear());
    canvas.addEventListener("pointerdown", (event) => { this.pressed = [event.clientX, event.clientY]; });
    canvas.addEventListener("pointerup", (event) => this.pick(event));
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
    setInterval(() => { if (this.splats.show()) this.redraw(); }, 1000);
    this.redraw();
  }

  /** `up`: upward in the run's coordinates. */
  setUp(up) {
    const turn = new Quaternion().setFromUnitVectors(new Vector3(...up).normalize(), new Vector3(0, 1, 0));
    // What is looked at stays where it is.
    const change = turn.clone().multiply(this.world.quaternion.clone().invert());
    this.camera.position.applyQuaternion(change);
    this.controls.target.applyQuaternion(change);
    this.world.quaternion.copy(turn);
    this.world.updateMatrixWorld(true);
    this.redraw();
  }

  setPath(points) {
    this.path = points;
    this.setLines("path", Line, points.flat(), COLORS.path, 0.9);
  }

  setKeyframes(keyframes, loops = []) {
    this.keyframes = keyframes;
    this.loops = loops;
    for (const kind of ["tracking", "mapping"]) {
      // The one that is looked from would only be in the way.
      const same = keyframes.filter((keyframe) => (keyframe.kind ?? "tracking") === kind && keyframe !== this.lookedFrom);
      const lines = same.flatMap((keyframe) => frustumLines(keyframe, this.halfExtent, FRUSTUM_M));
      this.setLines(kind, LineSegments, lines, COLORS[kind], 0.6);
    }
    const places = new Map(keyframes.map((keyframe) => [keyframe.id, keyframe.position]));
    const ends = loops.flatMap(([from, to]) => [places.get(from), places.get(to)]);
    this.setLines("loop", LineSegments, ends.every(Boolean) ? ends.flat() : [], COLORS.loop, 1);
  }

  /** Where the camera is now. */
  setCurrent(pose) {
    this.current = pose;
    this.setLines("current", LineSegments, frustumLines(pose, this.halfExtent, 2.5 * FRUSTUM_M), COLORS.current, 1);
    if (this.follows) this.moveBehind(pose, 0.12);
  }

  setLines(name, Kind, values, color, opacity) {
    this.lines[name] ??= (() => {
      const line = new Kind(new BufferGeometry(), lineMaterial(color, opacity));
      line.frustumCulled = false;
      line.renderOrder = 10;
      this.world.add(line);
      return line;
    })();
    const geometry = this.lines[name].geometry;
    geometry.dispose();
    geometry.setAttribute("position", new Float32BufferAttribute(values, 3));
    this.redraw();
  }

  show(names, isShown) {
    for (const name of names) if (this.lines[name]) this.lines[name].visible = isShown;
    this.redraw();
  }

  /** Stays behind the camera, or no longer. */
  follow(isOn) {
    this.follows = isOn;
    this.onFollow?.(isOn);
    if (isOn && this.current) this.moveBehind(this.current, 1);
  }

  release() {
    this.flight = null;
    if (this.lookedFrom) { this.lookedFrom = null; this.setKeyframes(this.keyframes, this.loops); }
    if (this.follows) this.follow(false);
  }

  poseInView({ quat: [w, x, y, z], position }, back, above) {
    const turn = new Quaternion(x, y, z, w);
    const forward = new Vector3(0, 0, 1).applyQuaternion(turn).applyQuaternion(this.world.quaternion);
    const place = new Vector3(...position).applyQuaternion(this.world.quaternion);
    const eye = place.clone().addScaledVector(forward, -back);
    eye.y += above;
    return [eye, place.addScaledVector(forward, 1.2)];
  }

  moveBehind(pose, share) {
    const [eye, target] = this.poseInView(pose, 0.55, 0.2);
    this.camera.position.lerp(eye, share);
    this.controls.target.lerp(target, share);
    this.redraw();
  }

  /** Looks from where a keyframe was taken. */
  lookFrom(keyframe) {
    this.release();
    this.lookedFrom = keyframe;
    this.setKeyframes(this.keyframes, this.loops);
    this.moveTo(this.poseInView(keyframe, 0.02, 0));
  }

  moveTo([eye, target]) {
    this.camera.position.copy(eye);
    this.controls.target.copy(target);
    this.redraw();
  }

  /** Stands behind a pose. */
  lookOver(pose) {
    this.moveTo(this.poseInView(pose, 0.55, 0.2));
  }

  /** Looks at all of it from above and aside. */
  overview() {
    this.release();
    const [least, largest] = this.splats.extent().map((corner) => corner.applyQuaternion(this.world.quaternion));
    const center = least.clone().add(largest).multiplyScalar(0.5), size = least.distanceTo(largest);
    this.controls.target.copy(center);
    this.camera.position.copy(center).add(new Vector3(0.28, 0.58, 0.36).multiplyScalar(size));
    this.redraw();
  }

  /** Flies along the trajectory, looking where keyframes looked. */
  fly() {
    this.release();
    if (this.keyframes.length > 1) this.flight = { at: 0 };
    this.redraw();
  }

  key(event, isDown) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.toLowerCase();
    if (!isDown) return this.keys.delete(key);
    if ("wasdqe".includes(key)) { this.release(); this.keys.add(key); this.redraw(); }
    if (key === "f") this.follow(!this.follows);
    if (key === "o") this.overview();
    if (key === "p") this.fly();
  }

  move(secs) {
    if (this.flight) {
      // A keyframe a second and a half, eased from one to the next.
      this.flight.at += secs / 1.5;
      const i = Math.floor(this.flight.at), share = this.flight.at - i;
      if (i + 1 >= this.keyframes.length) { this.flight = null; return false; }
      const [a, b] = [this.keyframes[i], this.keyframes[i + 1]].map((pose) => this.poseInView(pose, 0.25, 0.08));
      this.camera.position.lerpVectors(a[0], b[0], share);
      this.controls.target.lerpVectors(a[1], b[1], share);
      return true;
    }
    if (this.keys.size === 0) return false;
    const ahead = this.controls.target.clone().sub(this.camera.position).normalize();
    const right = ahead.clone().cross(this.camera.up).normalize();
    const step = new Vector3();
    const add = (key, axis, sign) => { if (this.keys.has(key)) step.addScaledVector(axis, sign); };
    add("w", ahead, 1); add("s", ahead, -1); add("d", right, 1); add("a", right, -1);
    add("e", this.camera.up, 1); add("q", this.camera.up, -1);
    step.multiplyScalar(SPEED_M * secs);
    this.camera.position.add(step);
    this.controls.target.add(step);
    return true;
  }

  /** The keyframe under the pointer, if it was a click. */
  pick(event) {
    if (!this.pressed || Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 4) return;
    const box = this.canvas.getBoundingClientRect();
    const distance = (keyframe) => {
      const place = new Vector3(...keyframe.position).applyQuaternion(this.world.quaternion).project(this.camera);
      if (place.z > 1) return Infinity;
      const x = box.left + 0.5 * (place.x + 1) * box.width, y = box.top + 0.5 * (1 - place.y) * box.height;
      return Math.hypot(x - event.clientX, y - event.clientY);
    };
    const nearest = this.keyframes.map((keyframe) => [distance(keyframe), keyframe]).sort((a, b) => a[0] - b[0])[0];
    if (nearest && nearest[0] < 16) this.onPick?.(nearest[1]);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.redraw();
  }

  /** Draws once, and on as long as something moves. */
  redraw() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame((now) => {
      this.isWaiting = false;
      if (!this.isDrawn(now)) return this.redraw();
      const secs = Math.min(0.1, (now - (this.last ?? now)) / 1000);
      this.last = now;
      const isMoving = this.move(secs);
      this.controls.update();
      this.renderer.render(this.scene, this.camera);
      this.begun = now;
      const gl = this.renderer.getContext();
      this.drawing = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
      if (isMoving) this.redraw(); else this.last = undefined;
      clearTimeout(this.rest);
      this.rest = setTimeout(() => this.setFineness(this.fineness), 600);
    });
  }

  /** Whether the last picture is done: a slow graphics device must not be given ever more to do. It gets
      coarser pictures while something moves. */
  isDrawn(now) {
    if (!this.drawing) return true;
    const gl = this.renderer.getContext();
    if (gl.getSyncParameter(this.drawing, gl.SYNC_STATUS) !== gl.SIGNALED) return false;
    gl.deleteSync(this.drawing);
    this.drawing = null;
    if (now - this.begun > 200) this.setFineness(0.5 * this.fineness);
    return true;
  }

  setFineness(ratio) {
    if (this.renderer.getPixelRatio() === ratio) return;
    this.renderer.setPixelRatio(ratio);
    this.redraw();
  }
}
