"""Settings as keyword arguments."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import fgs_slam


def test_groups_and_dotted_names() -> None:
    grouped = fgs_slam.Config(seed=2, mapping={"iterations_per_frame": 5, "loss": {"normalize_depth": False}})
    dotted = fgs_slam.Config(
        **{
            "seed": np.int64(2),
            "mapping.iterations_per_frame": np.float32(5),
            "mapping.loss.normalize_depth": np.bool_(False),
        }
    )
    assert grouped == dotted != fgs_slam.Config()
    settings = tomllib.loads(grouped.to_toml())
    assert settings["seed"] == 2 and settings["mapping"]["iterations_per_frame"] == 5
    assert settings["mapping"]["loss"]["normalize_depth"] is False


def test_files(tmp_path: Path) -> None:
    config = fgs_slam.Config(surface={"noise_power": 1.5})
    file = tmp_path / "settings.toml"
    file.write_text(config.to_toml())
    assert fgs_slam.Config(file) == fgs_slam.Config(str(file)) == config
    assert fgs_slam.Config(file, surface={"noise_power": 2.0}) != config


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mapping": {"prune_evry": 3}}, "mapping.prune_evry=3: unknown field `prune_evry`"),
        ({"maping": {"prune_every": 3}}, "unknown field `maping`"),
        ({"mapping.prune_every": 0}, "mapping.prune_every = 0 is not possible"),
        ({"mapping": {"prune_every": "often"}}, '"often" is given where a whole number'),
        ({"mapping": {"prune_every": True}}, "true"),
        ({"mapping": {"prune_every": None}}, "mapping.prune_every: a value of type NoneType is no setting"),
        ({"seed": -1}, "seed=-1"),
        ({"a b": 1}, "a b=1"),
        ({"": 1}, "=1"),
    ],
)
def test_bad_settings_are_named(settings: dict[str, object], words: str) -> None:
    with pytest.raises(fgs_slam.SettingError) as refusal:
        fgs_slam.Config(**settings)
    assert words in str(refusal.value)
    assert isinstance(refusal.value, ValueError)


def test_a_bad_file_is_named_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("seed = 1\n[mapping]\nprune_every = 0\n")
    with pytest.raises(fgs_slam.SettingError, match=r"settings\.toml:3: mapping\.prune_every = 0"):
        fgs_slam.Config(file)
    with pytest.raises(fgs_slam.SettingError, match=r"nowhere\.toml"):
        fgs_slam.Config(tmp_path / "nowhere.toml")
