"""A base by RTCM 3 over TCP in the running graph: the solution is that of the bag's base."""

from dataclasses import replace

import graph_runs
import numpy as np
import pytest
from base_caster import caster
from graph_runs import RATE

from deepseis_bringup.base import with_base
from deepseis_bringup.export.rtcm_msm import msm7
from deepseis_bringup.export.rtcm_station import reference_point
from deepseis_bringup.graph import GraphConfig
from deepseis_bringup.inertial import assistance
from deepseis_bringup.offline import OfflineChain
from deepseis_bringup.simulation.simulate import simulate
from deepseis_core.ros import codecs
from deepseis_core.types import PreciseStatus
from deepseis_frontend.base_events import BaseReference
from deepseis_frontend.nodes.base_bag import BaseBag
from deepseis_sim.base_station import BaseConfig
from deepseis_sim.scenario import load_scenario
from deepseis_sim.sky import SkyConfig

pytestmark = pytest.mark.launch

SECONDS, LAST = 14.0, 11.4
"""Length of the run; when the base says its last epoch [s]."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Ten satellites and a base five times a second."""
    still = load_scenario("static", short=True)
    small = replace(
        still, duration=SECONDS, base=BaseConfig(rate_hz=5), sky=SkyConfig(satellites=10)
    )
    folder = tmp_path_factory.mktemp("scene") / "in"
    simulate(small, folder, progress=False)
    return folder / "bag"


@pytest.fixture(scope="module")
def parameters(bag):
    known = assistance(bag)
    known["pvt"] |= {"still_until_s": 13.9, "base_lost_s": 1.0}
    return {kind: known[kind] for kind in ("pvt", "acquisition")}


@pytest.fixture(scope="module")
def expected(bag, parameters):
    """Positions of the chain in one process on the bag's own base, by topic."""
    config = GraphConfig(source={"file": str(bag)}, sample_rate_hz=RATE, parameters=parameters)
    found = {"gnss/rtk": [], "gnss/precise": []}
    for output in OfflineChain(with_base(config)).run():
        if output.topic in found:
            found[output.topic].append(output.value)
    return found


@pytest.fixture(scope="module")
def live(bag, parameters, tmp_path_factory):
    """A run whose base says the same over TCP, in pieces, and is lost in its middle."""
    epochs = list(BaseBag(bag).epochs())
    place = with_base(GraphConfig(source={"file": str(bag)}, sample_rate_hz=RATE))
    place = place.parameters["pvt"]["base_position_ecef"]
    said = [msm7(3, o) for o in epochs if o.sample_index <= LAST * RATE]

    def answer(link, _request, number):
        if not number:
            link.sendall(reference_point(3, place) + b"".join(said) + said[0][:50])

    with caster(answer, asks=False) as port:
        run = graph_runs.run(
            bag,
            tmp_path_factory.mktemp("live") / "run",
            _satellites(epochs),
            base_from=f"tcp://127.0.0.1:{port}",
            record_if=False,
            timeout=150.0,
            parameters={**parameters, "base_source": {"base_stale_s": 1.0}},
        )
    return run


def _satellites(epochs):
    return tuple(sorted({name for o in epochs for name in o.satellites}))


def values(run, topic):
    payloads = run.payloads()[f"/{topic}"]
    return [codecs.PRECISE_POSITION.decode(data)[0] for data in payloads]


def test_positions_are_those_against_the_bags_base(live, expected):
    got, file = values(live, "gnss/rtk"), expected["gnss/rtk"]
    assert len(got) == len(file)
    early = [k for k, v in enumerate(file) if v.sample_index < (LAST + 0.2) * RATE]
    assert [got[k].status for k in early] == [file[k].status for k in early]
    fixed = [k for k in early if file[k].status == PreciseStatus.FIX]
    assert len(fixed) > 20
    difference = [got[k].displacement_enu - file[k].displacement_enu for k in fixed]
    # Phases in steps of 0.14 mm, the reference point in steps of 0.1 mm.
    assert np.abs(difference).max() < 5e-4
    assert [got[k].base_age for k in fixed] == [file[k].base_age for k in fixed]
    assert np.all(np.array([file[k].base_age for k in fixed]) < 0.41)


def test_the_station_alone_goes_on_as_without_a_base_and_the_loss_is_said(live, expected):
    alone, file = values(live, "gnss/precise"), expected["gnss/precise"]
    assert [v.displacement_enu.tobytes() for v in alone] == [
        v.displacement_enu.tobytes() for v in file
    ]
    last = values(live, "gnss/rtk")[-1]
    assert last.base_age == pytest.approx(last.sample_index / RATE - LAST, abs=0.1)
    *_, (level, text, counts) = live.statuses()["base_source"]
    assert level == 1
    assert "base lost: no epoch for 2 s" in text
    assert "closed the connection" in text
    assert int(counts["link_lost"]) == int(counts["link_connections"]) >= 2
    assert int(counts["link_epochs"]) == int(counts["epochs"]) == round(5 * LAST) + 1
    assert "base lost" in live.statuses()["pvt"][-1][1]


def test_the_bag_holds_the_base_for_a_replay(live, bag):
    reference, *epochs = BaseBag(live.bag).events()
    assert isinstance(reference, BaseReference)
    sent = [o for o in BaseBag(bag).epochs() if o.sample_index <= LAST * RATE]
    assert [o.tow_ns for o in epochs] == [o.tow_ns for o in sent]
    # The sender's clock is not the signal's: samples are those of the epochs' own times.
    assert [o.sample_index for o in epochs] == sorted({o.sample_index for o in epochs})
