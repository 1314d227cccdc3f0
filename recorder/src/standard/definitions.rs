//! The definitions of the standard types, as ROS 2 Jazzy has them, without comments and
//! constants.

use std::fmt::Write as _;

use crate::schema::SEPARATOR;

/// Names and fields.
const TYPES: &[(&str, &str)] = &[
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"),
    (
        "std_msgs/Header",
        "builtin_interfaces/Time stamp\nstring frame_id\n",
    ),
    (
        "std_msgs/ColorRGBA",
        "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    ),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    (
        "geometry_msgs/Quaternion",
        "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    ),
    (
        "geometry_msgs/Pose",
        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    ),
    (
        "geometry_msgs/PoseStamped",
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    ),
    (
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    ),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    (
        "tf2_msgs/TFMessage",
        "geometry_msgs/TransformStamped[] transforms\n",
    ),
    (
        "nav_msgs/Path",
        "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n",
    ),
    (
        "sensor_msgs/LaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\n\
         float32 angle_increment\nfloat32 time_increment\nfloat32 scan_time\n\
         float32 range_min\nfloat32 range_max\nfloat32[] ranges\nfloat32[] intensities\n",
    ),
    (
        "sensor_msgs/CompressedImage",
        "std_msgs/Header header\nstring format\nuint8[] data\n",
    ),
    (
        "ackermann_msgs/AckermannDrive",
        "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n\
         float32 acceleration\nfloat32 jerk\n",
    ),
    (
        "ackermann_msgs/AckermannDriveStamped",
        "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n",
    ),
    (
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    ),
    (
        "geometry_msgs/Twist",
        "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    ),
    (
        "geometry_msgs/TwistWithCovariance",
        "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    ),
    (
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\n\
         geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n",
    ),
    ("diagnostic_msgs/KeyValue", "string key\nstring value\n"),
    (
        "diagnostic_msgs/DiagnosticStatus",
        "byte level\nstring name\nstring message\nstring hardware_id\n\
         diagnostic_msgs/KeyValue[] values\n",
    ),
    (
        "diagnostic_msgs/DiagnosticArray",
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    ),
    ("visualization_msgs/UVCoordinate", "float32 u\nfloat32 v\n"),
    (
        "visualization_msgs/MeshFile",
        "string filename\nuint8[] data\n",
    ),
    (
        "visualization_msgs/Marker",
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n\
         geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n\
         builtin_interfaces/Duration lifetime\nbool frame_locked\n\
         geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n\
         sensor_msgs/CompressedImage texture\n\
         visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n\
         string mesh_resource\nvisualization_msgs/MeshFile mesh_file\n\
         bool mesh_use_embedded_materials\n",
    ),
    (
        "visualization_msgs/MarkerArray",
        "visualization_msgs/Marker[] markers\n",
    ),
];

fn fields(name: &str) -> Option<&'static str> {
    TYPES
        .iter()
        .find_map(|(known, fields)| (*known == name).then_some(*fields))
}

/// The types that a definition names.
fn named(fields: &'static str) -> impl Iterator<Item = &'static str> {
    let words = fields.lines().filter_map(|line| line.split(' ').next());
    let words = words.filter(|word| word.contains('/'));
    words.map(|word| word.trim_end_matches("[]"))
}

/// The definition of a type such as `nav_msgs/Path` in the format `ros2msg`, with all that
/// are nested in it; empty for a type that is not in the list.
pub fn definition(name: &str) -> String {
    let own = fields(name).unwrap_or_default();
    let mut nested: Vec<&'static str> = named(own).collect();
    let mut text = String::from(own);
    let mut at = 0;
    while let Some(inner) = nested.get(at).copied() {
        at += 1;
        if nested[..at - 1].contains(&inner) {
            continue;
        }
        let own = fields(inner).unwrap_or_default();
        // Writing to a String cannot fail.
        let _ = write!(text, "{SEPARATOR}\nMSG: {inner}\n{own}");
        nested.extend(named(own));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definition_has_each_nested_type_once() {
        let text = definition("visualization_msgs/MarkerArray");
        assert!(text.starts_with("visualization_msgs/Marker[] markers\n"));
        for (name, fields) in TYPES {
            for inner in named(fields) {
                assert!(super::fields(inner).is_some(), "{name}: {inner}");
            }
        }
        for nested in [
            "std_msgs/Header",
            "geometry_msgs/Point",
            "std_msgs/ColorRGBA",
        ] {
            assert_eq!(
                text.matches(&format!("MSG: {nested}\n")).count(),
                1,
                "{text}"
            );
        }
        assert!(!text.contains("MSG: nav_msgs/Path"));
        assert_eq!(definition("nowhere/Nothing"), "");
    }
}
