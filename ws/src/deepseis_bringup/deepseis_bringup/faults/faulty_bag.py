"""Input bags with faults put into them: for the bench, and to try a station on its own record."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Final

from deepseis_bringup.bags.input_bag import FOREVER_S, offered
from deepseis_bringup.bags.mcap_recording import BagWriter
from deepseis_bringup.graph import TYPES
from deepseis_core.errors import InputError
from deepseis_core.imu_message import decode_imu, encode_imu
from deepseis_core.mcap_scan import McapScan, Message
from deepseis_core.ros import codecs
from deepseis_core.sample_clock import SampleClock
from deepseis_frontend.if_bag import IfBag, bag_files, decode_if_block
from deepseis_sim.faults import TOPIC_OF, Fault, FaultyInputs

BESIDE: Final = ("truth.npz", "*.rnx")
"""Files beside a simulated bag that its replay looks for."""


def faulty_bag(
    bag: Path, folder: Path, faults: Sequence[Fault], *, seed: int = 1
) -> dict[str, int]:
    """Copy a bag with faults put in; truth, orbits and the base's RINEX come with it.

    Parameters
    ----------
    bag : Path
        The bag's folder, or an MCAP file, with IF samples.
    folder : Path
        New or empty; gets ``bag/``, the files beside, and ``faults.json``.
    faults : sequence of Fault
    seed : int, optional
        Of what is drawn by chance.

    Returns
    -------
    dict
        How many messages each fault dropped or changed.

    Raises
    ------
    InputError
        The bag cannot be read, or a fault found nothing to spoil.
    """
    source = IfBag(bag)
    clock = SampleClock(source.start_utc_ns or 0, source.sample_rate_hz)
    inputs = FaultyInputs(faults, seed)
    files = bag_files(bag)
    first = McapScan(files[0])
    begin = next(first.messages(), None)
    if begin is None:
        raise InputError(bag, "holds no messages")
    records = {**first.metadata, "faults": {str(n): str(f) for n, f in enumerate(faults)}}
    with BagWriter(folder / "bag", records, flush_interval=FOREVER_S) as writer:
        for message in chain.from_iterable(McapScan(file).messages() for file in files):
            _copy(writer, message, _changed(message, inputs, clock))
    untouched = [name for name, count in inputs.touched.items() if not count]
    if untouched:
        what = f"fault {untouched[0]}"
        topic = TOPIC_OF[Fault.parse(untouched[0]).kind]
        raise InputError(what, f"spoils nothing in {bag}", f"it needs {topic} at its time")
    for pattern in BESIDE:
        for path in bag.resolve().parent.glob(pattern):
            shutil.copy2(path, folder / path.name)
    (folder / "faults.json").write_text(json.dumps(inputs.touched, indent=2) + "\n")
    return dict(inputs.touched)


def _changed(
    message: Message, inputs: FaultyInputs, clock: SampleClock
) -> bytes | memoryview | None:
    """Return what a message becomes; None: it is missing."""
    topic, rate = message.channel.topic.lstrip("/"), clock.sample_rate_hz
    if topic == "imu/data_raw":
        sample, utc_ns = decode_imu(message.data, clock)
        changed = inputs.imu(sample, sample.sample_index / rate)
        if changed is None or changed is sample:
            return None if changed is None else message.data
        return encode_imu(changed, utc_ns)
    if topic == "if/samples":
        stamp, block = decode_if_block(message.data)
        left = inputs.block(block, block.sample_index / rate)
        if left is None or left is block:
            return None if left is None else message.data
        return codecs.IF_BLOCK.encode(left, stamp)
    if topic == "base/observations":
        epoch = codecs.OBSERVATIONS.decode(bytes(message.data))[0]
        return message.data if inputs.keeps_base(epoch.sample_index / rate) else None
    return message.data


def _copy(writer: BagWriter, message: Message, data: bytes | memoryview | None) -> None:
    topic, type_name = message.channel.topic, message.channel.type_name
    known = TYPES.get(topic.lstrip("/"))
    if known is not None:
        writer.add_topic(topic, type_name, offered(known[1]))
    if data is not None:
        times = message.log_time_ns, message.publish_time_ns
        writer.write(topic, type_name, data, *times)
