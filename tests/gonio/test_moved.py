"""Paths of earlier versions: each is the module of today, whoever imports it first."""

import subprocess
import sys
from importlib import import_module

import pytest

from gonio.moved import MOVED, new_path


@pytest.mark.parametrize("old", MOVED)
def test_an_old_path_is_the_module_of_today(old: str) -> None:
    assert import_module(old) is import_module(MOVED[old])


def test_what_is_in_a_package_that_moved_has_moved_with_it() -> None:
    assert new_path("gonio.rig.protocols") == "gonio.lab.rig.protocols"
    assert new_path("gonio.models.blinn") is None


def test_a_plug_in_that_names_the_old_path_alone_sees_the_same_classes() -> None:
    code = (
        "from gonio.rig.protocols import Pose as old; import gonio.rig\n"
        "from gonio.lab.rig import Pose; assert old is Pose is gonio.rig.Pose\n"
        "from gonio.rig.description import SampleDescription; from gonio.acquisition.measure import load_sample\n"
        "from gonio import rig; assert rig.__name__ == rig.__spec__.name == 'gonio.lab.rig'"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stderr == ""


def test_a_module_that_never_was_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"gonio\.lab\.rig\.nothing"):
        import_module("gonio.rig.nothing")
