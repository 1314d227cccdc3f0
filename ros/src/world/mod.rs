//! A ROS robot as the world of a run: scan and odometry make the observation, its path or its
//! scan the road, and the command is `ackermann_msgs/AckermannDriveStamped`.
//!
//! | module | thread | holds |
//! |---|---|---|
//! | [`robot`](mod@robot) | the tick's, with real-time priority | the robot as the crate `robot` drives it |
//! | `ears` | Zenoh's | messages in: decoded, checked, dated, left for the tick |
//! | `sweep` | Zenoh's | a scan on the beams of `[scanner]` |
//! | `voice` | its own, `ros` | the connection, the commands out, the lines |
//! | `lay` | `ros` | a route of the newest path |
//!
//! What passes between the threads goes through triple buffers: the tick neither waits nor
//! allocates, and sees only the newest. `ros/tests/robot.rs` counts the allocations.

mod ears;
mod lay;
pub mod robot;
mod sweep;
mod voice;

pub use robot::RosRobot;
