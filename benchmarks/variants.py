"""Every choice that is a setting, run on every recording.

    python benchmarks/variants.py OUT "RECORDING [options of fgs run]"...

runs `fgs` (target/release/fgs; build it first) once for each variant and recording, appends each result to
OUT/raw.csv, and writes OUT/README.md from it. A result that raw.csv already holds is not made again, so an
interrupted table goes on where it stopped, and an old one is only written anew.
"""
import argparse
import csv
import os
import pathlib
import platform
import shlex
from concurrent.futures import ThreadPoolExecutor

import fgs_run

def changed(*settings):
    """Options that change settings."""
    return [word for setting in settings for word in ("--set", setting)]


# The options of each variant.
VARIANTS = {
    "defaults": [],
    "mask: opacity, depth": changed("seeding.depth_mask=true"),
    "mask: opacity, depth, colour": changed("seeding.depth_mask=true", "seeding.color_mask=true"),
    "covisible keyframes: 0.7": changed("mapping.covisible_probability=0.7"),
    "depth: not normalised": changed("mapping.loss.normalize_depth=false"),
    "colour: only where depth is": changed("mapping.loss.mask_color_by_depth=true"),
    "holes: left empty": changed("seeding.fill_holes=false"),
    "tracking: depth alone": changed("tracking.color=false"),
    "slower shapes and opacities": changed("mapping.learning_rates.log_scales=1e-2", "mapping.learning_rates.opacity_logits=0.04"),
    "refined by 2000 steps": ["--refine", "2000"],
}
COLUMNS = ["psnr_valid_depth_db", "psnr_db", "psnr_exposure_valid_depth_db", "psnr_heldout_db", "ssim", "depth_l1_m", "ate_rmse_m",
           "frames_lost", "num_gaussians", "fps"]


def run(recording, options, variant, threads):
    """The metrics of one run, as one row of raw.csv; of its refined map, if it has one."""
    metrics = fgs_run.metrics(recording, [*options, *VARIANTS[variant], "--threads", str(threads)])
    metrics |= metrics.get("refined") or {}
    name = pathlib.Path(recording).name
    return {"recording": name, "variant": variant, "commit": metrics["commit"]} | {key: metrics[key] for key in COLUMNS}


def table(rows):
    """Markdown: one line for each variant, in each cell one figure for each recording."""
    recordings = list(dict.fromkeys(row["recording"] for row in rows))
    found = {(row["recording"], row["variant"]): row for row in rows}
    head = [f"| variant (figures: {', '.join(recordings)}) | PSNR valid, dB | mean | with exposure, dB | PSNR all, dB | SSIM | ATE, cm | lost | gaussians, thousands |", "|---" * 9 + "|"]
    lines = []
    for variant in VARIANTS:
        cells = [found.get((recording, variant), {}) for recording in recordings]
        if not any(cells):
            continue
        figure = lambda cell, key, form, scale: form.format(scale * float(cell[key])) if cell.get(key) not in (None, "") else "-"
        figures = lambda key, form, scale=1.0: " / ".join(figure(cell, key, form, scale) for cell in cells)
        mean = f'{sum(float(cell["psnr_valid_depth_db"]) for cell in cells) / len(cells):.2f}' if all(cells) else "-"
        columns = [variant, figures("psnr_valid_depth_db", "{:.2f}"), mean, figures("psnr_exposure_valid_depth_db", "{:.2f}"),
                   figures("psnr_db", "{:.2f}"), figures("ssim", "{:.3f}"), figures("ate_rmse_m", "{:.4f}", 100), figures("frames_lost", "{:.0f}"), figures("num_gaussians", "{:.0f}", 1e-3)]
        lines.append("| " + " | ".join(columns) + " |")
    return "\n".join(head + lines)


def processor():
    """Its name, where the system tells (Linux)."""
    info = pathlib.Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("recordings", nargs="*")
    parser.add_argument("--only", nargs="+", choices=VARIANTS, default=list(VARIANTS), help="these variants")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    raw = options.out / "raw.csv"
    rows = list(csv.DictReader(raw.open())) if raw.exists() else []
    done = {(row["recording"], row["variant"]) for row in rows}
    todo = [(words[0], words[1:], variant) for words in map(shlex.split, options.recordings) for variant in options.only
            if (pathlib.Path(words[0]).name, variant) not in done]
    with raw.open("a") as file, ThreadPoolExecutor(options.jobs) as pool:
        writer = csv.DictWriter(file, ["recording", "variant", "commit", *COLUMNS])
        if not rows:
            writer.writeheader()
        for row in pool.map(lambda job: run(*job, threads=1), todo):
            rows.append(row)
            writer.writerow(row)
            file.flush()
            print(row["recording"], row["variant"], row["psnr_valid_depth_db"], row["ate_rmse_m"], flush=True)
    commits = ", ".join(sorted({row["commit"][:7] for row in rows}))
    commands = "\n".join(f'    {pathlib.Path(words[0]).name} {" ".join(words[1:])}' for words in map(shlex.split, options.recordings))
    if commands:
        (options.out / "README.md").write_text(
            f"# Variants\n\n{processor()}; commit {commits}; lockstep, one thread. Made by `benchmarks/variants.py` from raw.csv "
            f"beside this file; recordings and their options:\n\n{commands}\n\n{table(rows)}\n")


if __name__ == "__main__":
    main()
