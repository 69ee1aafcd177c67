"""ROS bags, through rosbags."""
