"""PSNR against seconds: one recording at several numbers of optimisation steps a frame.

    cargo build --release
    python benchmarks/convergence.py RECORDING [--fgs target/release/fgs] [OPTIONS OF fgs run]

prints a table row for each: steps a frame, seconds from the first frame to the last step (decoding included), PSNR where depth
is measured, gaussians.
"""
import argparse
import json
import pathlib
import subprocess
import tempfile

STEPS_PER_FRAME = (0.7, 1.4, 2.8, 5.6)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=pathlib.Path)
    parser.add_argument("--fgs", type=pathlib.Path, default=pathlib.Path(__file__).parents[1] / "target/release/fgs")
    arguments, run_options = parser.parse_known_args()
    print("| steps a frame | seconds | PSNR, dB | gaussians |\n|---|---|---|---|")
    for steps in STEPS_PER_FRAME:
        with tempfile.TemporaryDirectory() as folder:
            out = pathlib.Path(folder) / "run"
            command = [arguments.fgs, "run", arguments.recording, "--eval", "--out", out, *run_options]
            subprocess.run([*command, "--set", f"mapping.iterations_per_frame={steps}"], check=True, capture_output=True)
            metrics = json.loads((out / "metrics.json").read_text())
        seconds = metrics["frames"] / metrics["fps"]
        print(f"| {steps} | {seconds:.1f} | {metrics['psnr_valid_depth_db']:.2f} | {metrics['num_gaussians']} |", flush=True)


if __name__ == "__main__":
    main()
