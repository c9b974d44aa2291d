"""One scored run of fgs, for the other scripts here."""
import json
import pathlib
import subprocess
import tempfile

FGS = pathlib.Path(__file__).parents[1] / "target/release/fgs"  # build it first


def metrics(recording, options, fgs=FGS):
    """metrics.json of `fgs run RECORDING --eval OPTIONS`."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder, "run")
        subprocess.run([fgs, "run", recording, *options, "--eval", "--out", out], check=True, stdout=subprocess.DEVNULL)
        return json.loads((out / "metrics.json").read_text())
