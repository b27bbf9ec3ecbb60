"""Numbers of the GPS and of the Earth, each with unit and source.

References
----------
[IS] IS-GPS-200, "NAVSTAR GPS Space Segment/Navigation User Interfaces".
[WGS] NGA.STND.0036, "Department of Defense World Geodetic System 1984", tables 3.1 to 3.6.
"""

SPEED_OF_LIGHT = 299792458.0  # [m/s] [IS] 20.3.4.3
GPS_PI = 3.1415926535898  # [-] pi of the broadcast semicircles, [IS] 20.3.3.4.3.2

L1_HZ = 1575.42e6  # [Hz] carrier, [IS] 3.3.1.1
L1_WAVELENGTH = SPEED_OF_LIGHT / L1_HZ  # [m]
CA_RATE_CPS = 1.023e6  # [chips/s] [IS] 3.3.2.3
CA_LENGTH = 1023  # [chips] a code period, 1 ms
CYCLES_PER_CHIP = L1_HZ / CA_RATE_CPS  # [-] 1540

GPS_GM = 3.986005e14  # [m^3/s^2] of the broadcast orbit, [IS] table 20-IV
GPS_EARTH_RATE = 7.2921151467e-5  # [rad/s] of the broadcast orbit, [IS] table 20-IV
GPS_RELATIVITY_F = -4.442807633e-10  # [s/m^0.5] -2 sqrt(GM)/c^2, [IS] 20.3.3.3.3.1

WGS84_A = 6378137.0  # [m] semi-major axis, [WGS] table 3.1
WGS84_F = 1.0 / 298.257223563  # [-] flattening, [WGS] table 3.1
WGS84_B = WGS84_A * (1.0 - WGS84_F)  # [m] semi-minor axis
WGS84_E2 = WGS84_F * (2.0 - WGS84_F)  # [-] first eccentricity squared
WGS84_GM = 3.986004418e14  # [m^3/s^2] with the atmosphere, [WGS] table 3.1
WGS84_EARTH_RATE = 7.292115e-5  # [rad/s] [WGS] table 3.1
WGS84_GRAVITY_EQUATOR = 9.7803253359  # [m/s^2] normal gravity, [WGS] table 3.6
WGS84_GRAVITY_POLE = 9.8321849379  # [m/s^2] normal gravity, [WGS] table 3.6

NS_PER_S = 1_000_000_000  # [ns/s]
S_PER_WEEK = 604_800  # [s]
NS_PER_WEEK = S_PER_WEEK * NS_PER_S  # [ns]
