"""Fixtures of the core's tests."""

import pytest

from deepseis_core.types import Ephemeris


@pytest.fixture
def orbit() -> Ephemeris:
    """G02 of 2022-01-01 as broadcast."""
    return Ephemeris(
        satellite="G02",
        week=2190,
        toe=518400.0,
        toc=518400.0,
        af0=-0.647393986583e-03,
        af1=-0.113686837722e-11,
        af2=1e-17,
        tgd=-0.176951289177e-07,
        sqrt_a=0.515366817474e04,
        eccentricity=0.206388905644e-01,
        i0=0.964744088915,
        omega0=-0.112496293255e01,
        omega=-0.146476911829e01,
        m0=-0.453245129719,
        delta_n=0.455626121514e-08,
        omega_dot=-0.868964767299e-08,
        i_dot=-0.262153776900e-09,
        cuc=-0.748783349991e-05,
        cus=0.423192977905e-05,
        crc=0.303625e03,
        crs=-0.14271875e03,
        cic=-0.258907675743e-06,
        cis=0.122934579849e-06,
        transmit_tow=512376.0,
    )
