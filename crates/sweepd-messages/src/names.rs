//! Names of topics.

/// A sensor's name as a part of a topic: characters other than letters, digits and `_` become `_`;
/// a leading digit gets `sensor_` before it, and so does no name at all.
pub fn token(sensor: &str) -> String {
    let token = sensor.replace(|one: char| !one.is_ascii_alphanumeric(), "_");
    if token.starts_with(|one: char| one.is_ascii_alphabetic() || one == '_') {
        token
    } else {
        format!("sensor_{token}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_sensors_are_parts_of_topics() {
        for (sensor, expected) in [
            ("roof", "roof"),
            ("front-left.1", "front_left_1"),
            ("192.168.1.201:2368", "sensor_192_168_1_201_2368"),
            ("ü", "_"),
            ("", "sensor_"),
        ] {
            assert_eq!(token(sensor), expected);
        }
    }
}
