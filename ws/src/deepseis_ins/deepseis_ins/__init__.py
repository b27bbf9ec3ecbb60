"""Inertial navigation, its fusion with GNSS, and the aiding of the tracking loops."""
