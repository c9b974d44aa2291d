"""PSNR against seconds: one recording at several numbers of optimisation steps a frame.

    cargo build --release
    python benchmarks/convergence.py RECORDING [--fgs target/release/fgs] [OPTIONS OF fgs run]

prints a table row for each: steps a frame, seconds from the first frame to the last step (decoding included), PSNR where depth
is measured, gaussians.
"""
import argparse
import pathlib

import fgs_run

STEPS_PER_FRAME = (0.7, 1.4, 2.8, 5.6)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=pathlib.Path)
    parser.add_argument("--fgs", type=pathlib.Path, default=fgs_run.FGS)
    arguments, run_options = parser.parse_known_args()
    print("| steps a frame | seconds | PSNR, dB | gaussians |\n|---|---|---|---|")
    for steps in STEPS_PER_FRAME:
        options = [*run_options, "--set", f"mapping.iterations_per_frame={steps}"]
        metrics = fgs_run.metrics(arguments.recording, options, arguments.fgs)
        seconds = metrics["frames"] / metrics["fps"]
        print(f"| {steps} | {seconds:.1f} | {metrics['psnr_valid_depth_db']:.2f} | {metrics['num_gaussians']} |", flush=True)


if __name__ == "__main__":
    main()
