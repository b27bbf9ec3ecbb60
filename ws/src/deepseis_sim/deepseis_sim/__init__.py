"""The test bench: ground motion, IMU, constellation and IF samples with known truth."""
