# The camera's optical frame in the LiDAR, and the LiDAR on the roof.
ros2 run tf2_ros static_transform_publisher --x 0.3 --y 0.1 --z -0.2 \
  --qx -0.648117413287 --qy 0.3932720239618 --qz -0.3270835403782 --qw 0.5641784215803 --frame-id lidar --child-frame-id camera_optical_frame
ros2 run tf2_ros static_transform_publisher 1.0 0.0 1.8 0.01 0.02 0.03 base_link lidar
