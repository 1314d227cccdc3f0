//! `vlaps-ros-world`: a ROS robot as the world of a run.

use std::process::ExitCode;

use vlaps_ros::settings::Settings;
use vlaps_ros::world::RosRobot;

fn main() -> ExitCode {
    robot::drive(|config| RosRobot::open(config, &Settings::load()?))
}
