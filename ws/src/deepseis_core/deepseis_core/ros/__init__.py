"""What the nodes share with ROS: parameters, quality of service, conversions."""
