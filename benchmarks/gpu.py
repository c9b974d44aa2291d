"""All measurements of a graphics device in one go: optimisation steps, and a recording from end to end.

    python benchmarks/gpu.py OUT [--quick] [--no-cpu] [--fgs BINARY] [--room DIR]

builds fgs with cargo, unless --fgs names a binary (on a machine without Rust one that was carried there), runs
`fgs bench --backend gpu`, makes a synthetic room in Replica's layout, runs it on the device in parallel mode and on the CPU in
lockstep, and writes OUT/gpu.md, the bars first. --quick takes small sizes, to try the script on a device in software: a few minutes.

Each part's result is kept in OUT (bench.jsonl, gpu_1.json, ..., cpu.json), and what is there is not made again. The CPU's run comes
last and takes a quarter of an hour and more; where a command may take only so long, or the device is lent, split it:

    python benchmarks/gpu.py OUT --fgs fgs --no-cpu --room room         # on the device's machine: minutes
    python benchmarks/gpu.py OUT --fgs fgs                              # there or elsewhere, OUT copied: adds the CPU's run

A part that was stopped begins anew. The room (--room, by default OUT/room) is made where it is missing: two gigabytes, in minutes.
"""
import argparse
import json
import pathlib
import statistics
import subprocess

import fgs_run

ROOT = pathlib.Path(__file__).parents[1]
SIZES = {"image": "1200x680", "gaussians": [100_000, 500_000, 2_000_000], "frames": 2000, "runs": 3, "options": []}
# Fewer points would not be tracked in so small an image.
QUICK = {"image": "320x240", "gaussians": [2000, 5000], "frames": 20, "runs": 1, "options": ["--set", "tracking.grid_stride_px=4"]}
STEP_GAUSSIANS = 500_000
# Of metrics.json: name, key, format, scale.
ROWS = [
    ("device", "backend", "{}", None), ("frames", "frames", "{}", None), ("frames lost", "frames_lost", "{}", None),
    ("frames a second, decoding included", "fps", "{:.1f}", 1), ("tracking, ms a frame", "tracking_ms", "{:.2f}", 1),
    ("mapping, ms a frame", "mapping_ms", "{:.2f}", 1), ("steps a frame", "iterations_per_frame", "{:.2f}", 1),
    ("PSNR where depth is, dB", "psnr_valid_depth_db", "{:.2f}", 1), ("PSNR held out, dB", "psnr_heldout_db", "{:.2f}", 1),
    ("SSIM", "ssim", "{:.4f}", 1), ("depth L1, cm", "depth_l1_m", "{:.3f}", 100), ("ATE, cm", "ate_rmse_m", "{:.4f}", 100),
    ("gaussians", "num_gaussians", "{}", None), ("device memory, MB", "device_bytes", "{:.0f}", 1e-6), ("threads", "threads", "{}", None),
]


def kept(path, make):
    """The text of a file, made first if it is not there."""
    if not path.exists():
        text = make()
        partial = path.with_suffix(".partial")
        partial.write_text(text)
        partial.rename(path)
    return path.read_text()


def bench(fgs, sizes):
    """What `fgs bench` prints: one event a line."""
    print("steps ...", flush=True)
    command = [fgs, "bench", "--backend", "gpu", "--json", "--size", sizes["image"], "--gaussians", ",".join(map(str, sizes["gaussians"]))]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def run(fgs, room, sizes, backend, mode):
    """metrics.json of a scored run. The room is made first if it is not there, as Replica's are recorded: exact depth and poses."""
    if not room.exists():
        command = [fgs, "synth", room, "--layout", "replica", "--size", sizes["image"], "--frames", str(sizes["frames"]), "--noise", "none"]
        subprocess.run(command, check=True)
    print(f"{backend}, {mode} ...", flush=True)
    options = ["--config", ROOT / "configs/replica.toml", *sizes["options"], "--backend", backend, "--mode", mode]
    return json.dumps(fgs_run.metrics(room, options, fgs), indent=2)


def row(*cells):
    return "| " + " | ".join(cells) + " |"


def bars(events, gpu, cpu, quick):
    """Markdown: what is to be reached, and what was."""
    steps = {event["gaussians"]: event["median_ms"] for event in events if event["event"] == "stage" and event["stage"] == "whole step"}
    gaussians = max(steps) if quick else STEP_GAUSSIANS
    fps = statistics.median(metrics["fps"] for metrics in gpu)
    psnr = statistics.median(metrics["psnr_valid_depth_db"] for metrics in gpu)
    loss_db = cpu["psnr_valid_depth_db"] - psnr if cpu else None
    memory_gb = max(metrics["device_bytes"] for metrics in gpu) / 1e9
    size = (QUICK if quick else SIZES)["image"]
    lines = [row("what", "bar", "measured", "met"), row(*["---"] * 4)]
    for what, bar, measured, met in [
        (f"a step of {gaussians} gaussians at {size}", "at most 2.0 ms (NVIDIA H200)", f"{steps[gaussians]:.3f} ms", steps[gaussians] <= 2.0),
        ("the same", "at most 1.2 ms", f"{steps[gaussians]:.3f} ms", steps[gaussians] <= 1.2),
        ("end to end", "at least 150 frames/s", f"{fps:.1f}", fps >= 150),
        ("the same", "at least 255 frames/s", f"{fps:.1f}", fps >= 255),
        ("PSNR below the CPU's in lockstep", "within 0.1 dB", f"{loss_db:.3f} dB" if cpu else "-", cpu and abs(loss_db) <= 0.1),
        ("device memory at the end of the run", "at most 2 GB", f"{memory_gb:.3f} GB", memory_gb <= 2.0),
    ]:
        lines.append(row(what, bar, measured, "-" if quick or met is None else "yes" if met else "no"))
    return "\n".join(lines)


def step_tables(events):
    """Markdown: one table for each scene."""
    number = lambda ms: "-" if ms is None else f"{ms:.4f}"
    tables = []
    for scene in (event for event in events if event["event"] == "scene"):
        size = f"{scene['input']}, {scene['gaussians']} gaussians"
        if scene["entries"] is not None:
            size += f", {scene['in_view']} in view, {scene['entries']} entries"
            size += f", at most {scene['longest_list']} in a tile and {scene['most_tiles']} tiles of a gaussian"
        lines = [f"{size}, {scene['device_bytes'] / 1e6:.0f} MB:\n",
                 row("stage", "median ms", "best ms", "floor ms", "nominal floor ms", "times the floor"), row(*["---"] * 6)]
        for event in events:
            if event["event"] == "stage" and event["gaussians"] == scene["gaussians"]:
                ratio = f"{event['median_ms'] / event['floor_ms']:.1f}" if event["floor_ms"] else "-"
                times = [number(event[key]) for key in ("median_ms", "best_ms", "floor_ms", "nominal_floor_ms")]
                lines.append(row(event["stage"], *times, ratio))
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def run_table(gpu, cpu):
    """Markdown: the runs side by side."""
    runs = {f"device, parallel, {i}": metrics for i, metrics in enumerate(gpu, 1)} | ({"CPU, lockstep": cpu} if cpu else {})
    cell = lambda value, form, scale: "-" if value is None else form.format(value * scale if scale else value)
    lines = [row("", *runs), row(*["---"] * (1 + len(runs)))]
    lines += [row(name, *(cell(metrics[key], form, scale) for metrics in runs.values())) for name, key, form, scale in ROWS]
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--quick", action="store_true", help="small sizes, which say nothing of the bars")
    parser.add_argument("--no-cpu", action="store_true", help="leave the CPU's run out, unless it is in OUT already")
    parser.add_argument("--fgs", type=pathlib.Path, help="a binary to use; default: build one")
    parser.add_argument("--room", type=pathlib.Path, help="the recording; default: OUT/room")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    sizes = QUICK if options.quick else SIZES
    room = options.room or options.out / "room"
    fgs = options.fgs
    if fgs is None:
        subprocess.run(["cargo", "build", "--release"], check=True, cwd=ROOT)
        fgs = fgs_run.FGS
    fgs = fgs.resolve()

    events = [json.loads(line) for line in kept(options.out / "bench.jsonl", lambda: bench(fgs, sizes)).splitlines()]
    device_run = lambda: run(fgs, room, sizes, "gpu", "parallel")
    gpu = [json.loads(kept(options.out / f"gpu_{i}.json", device_run)) for i in range(1, sizes["runs"] + 1)]

    def write(cpu):
        machine = events[0]
        (options.out / "gpu.md").write_text(
            f"# {machine['device']}\n\nCommit {gpu[0]['commit'][:7]}. Made by `benchmarks/gpu.py{' --quick' if options.quick else ''}` from the "
            f"files beside this one. Measured on the device in the same run: {machine['bytes_per_sec'] / 1e9:.0f} GB/s, "
            f"{machine['flops_per_sec'] / 1e12:.2f} TFLOP/s; an empty dispatch and its barrier {machine['dispatch_secs'] * 1e6:.2f} us, "
            f"{machine['indirect_dispatch_secs'] * 1e6:.2f} us with its size on the device."
            f"{''.join(' Note: ' + caveat + '.' for caveat in machine['caveats'])}\n\n{bars(events, gpu, cpu, options.quick)}\n\n"
            "## Steps\n\nStages by the device's clock, each in a pass of its own; whole steps by the wall clock, many on their way at once, "
            "on eight views by turns unless it says one; a keyframe's phases by the wall clock, waited for. "
            "Floors: crates/fgs_cli/src/bench/gpu_floors.rs, at the measured rates and at 4 TB/s and 60 TFLOP/s.\n\n"
            f"{step_tables(events)}\n\n## End to end\n\n`fgs synth --layout replica --size {sizes['image']} --frames {sizes['frames']} --noise none`, "
            f"run with `--config configs/replica.toml{''.join(' ' + word for word in sizes['options'])}`.\n\n{run_table(gpu, cpu)}\n")

    path = options.out / "cpu.json"
    write(None)
    if path.exists() or not options.no_cpu:
        write(json.loads(kept(path, lambda: run(fgs, room, sizes, "cpu", "lockstep"))))
    print(f"{options.out / 'gpu.md'}:\n{(options.out / 'gpu.md').read_text().split('## Steps')[0]}")


if __name__ == "__main__":
    main()
