//! Messages `velodyne_msgs/VelodyneScan`, written byte by byte as their specification says.

/// The type of the messages, as ROS 2 names it.
pub const SCAN: &str = "velodyne_msgs/msg/VelodyneScan";

/// A packet: its stamp in nanoseconds, and the byte that its data repeat.
pub type Stamped = (i64, u8);

/// A VelodyneScan in CDR, in either byte order.
pub fn cdr(packets: &[Stamped], big_endian: bool) -> Vec<u8> {
    let word = |value: u32| {
        if big_endian {
            value.to_be_bytes()
        } else {
            value.to_le_bytes()
        }
    };
    let mut message = vec![0, u8::from(!big_endian), 0, 0];
    // The header: seconds, nanoseconds, and a frame id whose length is no multiple of four.
    message.extend([word(7), word(8), word(6)].as_flattened());
    message.extend(b"lidar\0\0\0");
    message.extend(word(packets.len() as u32));
    for &(stamp_ns, byte) in packets {
        message.resize(message.len().next_multiple_of(4), 0);
        let seconds = stamp_ns.div_euclid(1_000_000_000) as i32;
        let nanoseconds = stamp_ns.rem_euclid(1_000_000_000) as u32;
        message.extend([word(seconds as u32), word(nanoseconds)].as_flattened());
        message.extend([byte; 1206]);
    }
    message
}
