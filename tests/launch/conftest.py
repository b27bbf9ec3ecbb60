"""One recording and its run, shared by all tests over DDS."""

import graph_runs
import pytest
from graph_runs import DURATION, Run


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    return graph_runs.recording(tmp_path_factory.mktemp("recording"), DURATION)


@pytest.fixture(scope="session")
def satellites(recording):
    return (graph_runs.ABSENT, *recording.satellites)


@pytest.fixture(scope="session")
def recorded(recording, satellites, tmp_path_factory) -> Run:
    """The whole recording through the graph in lockstep, samples recorded too."""
    return graph_runs.run(recording.if_path, tmp_path_factory.mktemp("recorded"), satellites)
