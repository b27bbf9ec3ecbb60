"""A new station: checks of its first minutes, an IMU's time offset and lever arm."""
