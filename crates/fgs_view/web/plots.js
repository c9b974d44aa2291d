// Curves of numbers over time, and the strip of verdicts.

const STYLE = getComputedStyle(document.documentElement);
const color = (name) => STYLE.getPropertyValue(name).trim();
const VERDICTS = { tracked: "--good", weak: "--weak", lost: "--bad" };

function begin(canvas) {
  const scale = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width * scale;
  canvas.height = height * scale;
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  return { context, width, height };
}

/** The least and the largest of values, but for a fiftieth at the top. */
function range(values, fromZero) {
  const sorted = [...values].sort((a, b) => a - b);
  const high = sorted[Math.floor(0.98 * (sorted.length - 1))];
  const low = fromZero ? 0 : sorted[0];
  const margin = 0.08 * (high - low || 1);
  return [fromZero ? 0 : low - margin, high + margin];
}

/** One point for each pixel at most: the last. */
function thinned(points, width) {
  const step = Math.max(1, Math.floor(points.length / width));
  return points.filter((_, i) => i % step === 0 || i === points.length - 1);
}

/** A curve of [x, y] with the last value in large. */
export function plot(canvas, label, points, unit, { digits = 1, fromZero = true, stroke = "--accent" } = {}) {
  const { context, width, height } = begin(canvas);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = color("--soft");
  context.fillText(label, 0, 12);
  if (points.length === 0) return;
  const value = points[points.length - 1][1];
  const text = value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
  context.textAlign = "right";
  context.fillText(unit, width, 14);
  const unitWidth = unit ? context.measureText(unit).width + 5 : 0;
  context.font = "600 18px system-ui, sans-serif";
  context.fillStyle = color("--text");
  context.fillText(text, width - unitWidth, 15);
  context.textAlign = "left";
  const top = 26, bottom = height - 4;
  const [low, high] = range(points.map((point) => point[1]), fromZero);
  const [first, last] = [points[0][0], points[points.length - 1][0]];
  const place = ([x, y]) => [
    ((x - first) / (last - first || 1)) * (width - 2) + 1,
    bottom - ((Math.min(Math.max(y, low), high) - low) / (high - low || 1)) * (bottom - top),
  ];
  context.strokeStyle = color("--line");
  context.lineWidth = 1;
  for (const y of [top, (top + bottom) / 2, bottom]) {
    context.beginPath(); context.moveTo(0, y + 0.5); context.lineTo(width, y + 0.5); context.stroke();
  }
  context.beginPath();
  thinned(points, width).forEach((point, i) => {
    const [x, y] = place(point);
    if (i === 0) context.moveTo(x, y); else context.lineTo(x, y);
  });
  context.strokeStyle = color(stroke);
  context.lineWidth = 1.6;
  context.stroke();
  context.lineTo(width - 1, bottom); context.lineTo(1, bottom);
  context.globalAlpha = 0.12; context.fillStyle = color(stroke); context.fill();
}

/** The verdicts of frames, with the keyframes above. */
export function strip(canvas, frames) {
  const { context, width, height } = begin(canvas);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = color("--soft");
  context.fillText("verdicts", 0, 12);
  if (frames.length === 0) return;
  const last = frames[frames.length - 1];
  context.textAlign = "right";
  context.font = "600 18px system-ui, sans-serif";
  context.fillStyle = color(VERDICTS[last.status] ?? "--soft");
  context.fillText(last.status, width, 15);
  const [top, step] = [26, width / Math.max(frames.length, 60)];
  frames.forEach((frame, i) => {
    context.fillStyle = color(VERDICTS[frame.status] ?? "--line");
    // Whole pixels: no seams.
    const [from, to] = [Math.floor(i * step), Math.ceil((i + 1) * step)];
    context.fillRect(from, top + 12, to - from, height - top - 12);
    if (frame.keyframe) {
      context.fillStyle = color(frame.keyframe === "mapping" ? "--mapping" : "--accent");
      context.fillRect(from, top, Math.min(to - from, 3), 9);
    }
  });
}
