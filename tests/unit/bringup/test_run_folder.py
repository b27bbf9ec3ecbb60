"""Where a command may put its folder, and what is said where it may not."""

import pytest

from deepseis_bringup.run_folder import new_run_folder
from deepseis_core.errors import InputError


def test_a_folder_that_cannot_be_looked_at_is_said_in_a_line(tmp_path):
    with pytest.raises(InputError, match="cannot be used: File name too long"):
        new_run_folder(tmp_path / ("x" * 300))


def test_a_new_or_empty_folder_is_taken_and_what_is_there_is_left_alone(tmp_path):
    assert new_run_folder(tmp_path / "new") == tmp_path / "new"
    assert new_run_folder(tmp_path) == tmp_path
    (tmp_path / "file").touch()
    for taken, reason in ((tmp_path, "not empty"), (tmp_path / "file", "is a file")):
        with pytest.raises(InputError, match=reason):
            new_run_folder(taken)
