"""IF sample formats and sources, IMU sources."""
