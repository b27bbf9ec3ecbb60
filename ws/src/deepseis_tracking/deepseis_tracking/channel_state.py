"""The plain data of a channel's kernel: state, settings in numbers, one row per integration."""

from __future__ import annotations

import numpy as np

from deepseis_core.types import TrackingEpochs

STATE = np.dtype(
    [
        ("mode", "i8"),
        ("next_sample", "i8"),  # first sample of the next integration
        ("period_count", "i8"),  # code periods since the handover
        ("bit_offset", "i8"),  # period_count % 20 at a bit edge, -1 unknown
        ("transmit_ms", "i8"),  # GPS ms of week at the start of the current period, -1 unknown
        ("mode_epochs", "i8"),  # integrations since the mode began
        ("polarity", "i8"),  # 0 unknown, 1 known (and put right)
        ("pending_flags", "i8"),  # to be set on the next epoch
        ("code_phase", "f8"),  # chips at next_sample
        ("carrier_phase", "f8"),  # cycles at next_sample
        ("nco_hz", "f8"),  # carrier loop output for the next integration, without aiding
        ("slope_hz", "f8"),  # frequency integrator
        ("slope_before", "f8"),  # the same before the last update
        ("accel", "f8"),  # acceleration integrator [Hz/s]
        ("code_slope", "f8"),  # DLL output [chips/s]
        ("mean_error", "f8"),  # carrier error, mean over 20 ms [cycles]
        ("last_i", "f8"),
        ("last_q", "f8"),
        ("lock_num", "f8"),  # filtered I^2 - Q^2
        ("lock_den", "f8"),  # filtered I^2 + Q^2 - 2
        ("power", "f8"),  # filtered |P|^2 - 2, fast (about 0.3 s): for the code lock
        ("brief", "f8"),  # the same, 0.06 s, of one integration
        ("usual", "f8"),  # the same, 1 s
        ("narrow_wide", "f8"),  # filtered narrow-to-wide power ratio, -1 not yet
        ("cross_i", "f8"),  # filtered lag-1 product of the 1 ms prompts
        ("cross_q", "f8"),
        ("cn0", "f8"),
        ("code_lock", "i8"),
        ("phase_lock", "i8"),
        ("unlocked_s", "f8"),  # time without phase lock in a tracking mode
        ("weak_s", "f8"),  # time below the loss threshold
        ("aid_held", "i8"),  # 1: the last try with aiding failed, lock without it first
        ("aid_failures", "i8"),  # in a row
        ("aid_wait_s", "f8"),  # before the next try
        ("aided_s", "f8"),  # time in phase lock with aiding
        ("settled_s", "f8"),  # time in phase lock on end
        ("narrow", "i8"),  # 1: has settled with aiding, the aided loop's gains hold
        ("pull_in_aided", "i8"),  # 1: this pull-in uses aiding
        ("fallback", "i8"),  # 1: short integrations, as the aiding is away (`fallback`)
        ("quiet_s", "f8"),  # for how long such integrations have seen no signal
        ("fallback_count", "i8"),  # changes into that
        ("agreed_s", "f8"),  # time that aiding has been compared with such a loop
        ("agreed_cycles", "f8"),  # what it has lacked in it
        ("piece_s", "f8"),  # the same, since the last mean was taken
        ("piece_cycles", "f8"),
        ("least_hz", "f8"),  # least and greatest mean of what it has lacked
        ("most_hz", "f8"),
        ("clock_hz", "f8"),  # oscillator's part of the frequency beside aiding and loop
        ("reset_epoch", "i8"),  # number of the aid epoch, policy "reset"
        ("weak", "i8"),  # 1: pull in open-loop; 2: that has found Doppler and bits
        ("bit_sums", "i8"),  # sums in bit_energy, open-loop pull-in
        ("noise", "f8"),  # per component and sample, standard deviation
        ("bit_energy", "f8", (20,)),
        ("recent_i", "f8", (20,)),  # last 1 ms prompts: bit search, fallback
        ("recent_q", "f8", (20,)),
    ]
)
"""State of one channel (one record)."""

CONFIG = np.dtype(
    [
        ("sample_rate", "f8"),
        ("spacing", "f8"),
        ("tap_offset", "i8"),
        ("pull_in_epochs", "i8"),
        ("bit_sync_epochs", "i8"),  # at the most
        ("pull_gains", "f8", (3,)),
        ("fll_gain", "f8"),
        ("track_gains", "f8", (3,)),
        ("aided_gains", "f8", (3,)),
        ("fallback_gains", "f8", (3,)),
        ("dll_fast_gain", "f8"),
        ("dll_gain", "f8"),
        ("lock_threshold", "f8"),
        ("unlock_threshold", "f8"),
        ("code_lock_dbhz", "f8"),
        ("loss_dbhz", "f8"),
        ("loss_s", "f8"),
        ("periods", "i8"),  # code periods in a tracking integration
        ("fallback_periods", "i8"),  # in one whose aiding is away; 0: the same
        ("relock_s", "f8"),  # 0: never
        ("weak_dbhz", "f8"),
        ("acceleration_form", "i8"),  # of aiding; 0: velocity form
        ("reset_samples", "i8"),  # length of an aid epoch, policy "reset"; 0: policy "continue"
    ]
)
"""Settings of one channel in numbers (one record)."""

AID = np.dtype(
    [
        ("valid", "i8"),
        ("first", "i8"),  # sample of knot 0
        ("step", "i8"),  # samples between knots
        ("through", "i8"),  # last sample that the aiding was made for
        ("clock_hz", "f8"),  # oscillator's part, NaN: unknown
    ]
)
"""Aiding of one channel beside its knots (one record)."""

_SKIPPED = ("satellite", "block_sample_index", "valid_through", "ephemeris_count", "mode")
_INTEGERS = {
    "sample_index": "i8",
    "sample_count": "i4",
    "transmit_ms": "i8",
    "flags": "u2",
}
_DOUBLES = (
    "code_phase_chips",
    "code_rate_cps",
    "carrier_phase_cycles",
    "carrier_doppler_hz",
    "carrier_doppler_rate",
    "carrier_doppler_accel",
)

EPOCH_FIELDS = tuple(n for n in TrackingEpochs.__dataclass_fields__ if n not in _SKIPPED)
"""Columns of one integration, named as in `deepseis_core.types.TrackingEpochs`."""

EPOCH = np.dtype([(n, _INTEGERS.get(n, "f8" if n in _DOUBLES else "f4")) for n in EPOCH_FIELDS])
"""One integration, as it is published."""
