"""Where a command may put its folder, and what is said where it may not."""

import pytest

from deepseis_bringup.run_folder import half_written_is_removed, new_run_folder
from deepseis_bringup.supervisor import StandstillError
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


@pytest.mark.parametrize(("error", "kept"), [(StandstillError, True), (InputError, False)])
def test_what_a_standstill_left_is_kept_for_who_looks_why(tmp_path, error, kept):
    folder = tmp_path / "run"

    def work():
        with half_written_is_removed(folder):
            (folder / "trackers.log").write_text("waits")
            raise error("graph", "nothing has moved")

    with pytest.raises(error):
        work()
    assert folder.exists() == kept
