//! `rcl_interfaces`: what every node of ROS 2 has beside its topics, the services for its parameters, their
//! events on `/parameter_events`, and the log on `/rosout`.

use crate::MessageType;
use crate::cdr::{CdrError, Reader, Writer};

/// A line of the log: [`encode_log`].
pub static LOG: MessageType = MessageType {
    name: "rcl_interfaces/msg/Log",
    hash: "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    definition: include_str!("../definitions/Log.txt"),
};

/// Event of parameters: [`encode_parameter_event`]. It is in no bag, and has no definition here.
pub static PARAMETER_EVENT: MessageType = MessageType {
    name: "rcl_interfaces/msg/ParameterEvent",
    hash: "RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
    definition: "",
};

/// A service: a message that asks, and one that answers. They are in no bag, and have no definition here.
#[derive(Debug)]
pub struct ServiceType {
    /// Its name below the node's.
    pub name: &'static str,
    /// What asks.
    pub request: MessageType,
    /// What answers.
    pub reply: MessageType,
}

macro_rules! service {
    ($type:literal, $name:literal, $request:literal, $reply:literal) => {
        ServiceType {
            name: $name,
            request: MessageType {
                name: concat!("rcl_interfaces/srv/", $type, "_Request"),
                hash: concat!("RIHS01_", $request),
                definition: "",
            },
            reply: MessageType {
                name: concat!("rcl_interfaces/srv/", $type, "_Response"),
                hash: concat!("RIHS01_", $reply),
                definition: "",
            },
        }
    };
}

/// The services for parameters, as [`Request`] has them.
pub static PARAMETER_SERVICES: [ServiceType; 6] = [
    service!(
        "ListParameters",
        "list_parameters",
        "a1b0b5d6b967a5b8ac5bc8563c3ea678f349e312a6a4967227c5a96bc5ce38df",
        "31b937b82de3612426be79f231e386259f97e8dc843e3f2845288b4bfa296bdd"
    ),
    service!(
        "GetParameters",
        "get_parameters",
        "135a9e1c3d7cebef792f6687d7ddf99949b21a0bd9a320d863a9110a3f5cf4d6",
        "9fa773b46e39cc5d02db6224d8fd520bb9caeeffc2b27c96c1e59431baba9f2a"
    ),
    service!(
        "GetParameterTypes",
        "get_parameter_types",
        "87d7ec5ef545d4daa289d500025d31fb2437bc8b8365ca367161c4dac4be33fd",
        "ac1335dce67c478e669434f6ac2fbff34fcd529580f272d3006785ba8b54e47f"
    ),
    service!(
        "DescribeParameters",
        "describe_parameters",
        "05dd1c2bc87dec2627105c8070d6f9725c781a4f2ab852975bf105462b82b644",
        "ad6747319613c6131589e062e095b469a46cc764f7d0f12a001a49e6cd893995"
    ),
    service!(
        "SetParameters",
        "set_parameters",
        "130d46386b7e84ea9ecf60608a4d83cbe5e5cb7c6cc5b712b7a4e3a6c254e932",
        "7a0e8140a0b8d98308fa81a5403a766e610af29a239caf54b7553227906fc266"
    ),
    service!(
        "SetParametersAtomically",
        "set_parameters_atomically",
        "db0bd950ed5ed867a0e90b225e44dea382d762c0762ff3e0ee842190042a59e5",
        "31b1a38c5b0b9d893ee24da45f69638f4561c78461d82d52750f429b534502b8"
    ),
];

/// Encodes a line of the log. `level` is 20 for information, 30 for a warning, 40 for an error.
pub fn encode_log(stamp_ns: i64, level: u8, logger: &str, line: &str, message: &mut Vec<u8>) {
    let mut writer = Writer::new(message);
    writer.time(stamp_ns);
    writer.u8(level);
    writer.text(logger);
    writer.text(line);
    // File, function and line of the source, which say nothing to users.
    writer.text("");
    writer.text("");
    writer.u32(0);
}

/// Encodes the parameters of a node that are new, and those that have changed, with their values; none is deleted.
pub fn encode_parameter_event(
    stamp_ns: i64,
    node: &str,
    new: &[(String, Value)],
    changed: &[(String, Value)],
    message: &mut Vec<u8>,
) {
    let mut writer = Writer::new(message);
    writer.time(stamp_ns);
    writer.text(node);
    for parameters in [new, changed, &[]] {
        writer.count(parameters.len());
        for (name, value) in parameters {
            writer.text(name);
            value.write(&mut writer);
        }
    }
}

/// A value of a parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Value {
    /// None.
    #[default]
    NotSet,
    /// A truth value.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Double(f64),
    /// A text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
    /// Truth values.
    Bools(Vec<bool>),
    /// Whole numbers.
    Integers(Vec<i64>),
    /// Numbers.
    Doubles(Vec<f64>),
    /// Texts.
    Texts(Vec<String>),
}

impl Value {
    /// Its number in `rcl_interfaces/msg/ParameterType`.
    pub fn type_number(&self) -> u8 {
        match self {
            Self::NotSet => 0,
            Self::Bool(_) => 1,
            Self::Integer(_) => 2,
            Self::Double(_) => 3,
            Self::Text(_) => 4,
            Self::Bytes(_) => 5,
            Self::Bools(_) => 6,
            Self::Integers(_) => 7,
            Self::Doubles(_) => 8,
            Self::Texts(_) => 9,
        }
    }

    /// A message has a field for each type; those of the other types are empty.
    fn write(&self, writer: &mut Writer<'_>) {
        writer.u8(self.type_number());
        writer.bool(matches!(self, Self::Bool(true)));
        writer.i64(if let Self::Integer(value) = self {
            *value
        } else {
            0
        });
        writer.f64(if let Self::Double(value) = self {
            *value
        } else {
            0.0
        });
        writer.text(if let Self::Text(value) = self {
            value
        } else {
            ""
        });
        let bytes: &[u8] = if let Self::Bytes(values) = self {
            values
        } else {
            &[]
        };
        writer.count(bytes.len());
        writer.raw(bytes);
        let bools: &[bool] = if let Self::Bools(values) = self {
            values
        } else {
            &[]
        };
        writer.count(bools.len());
        bools.iter().for_each(|value| writer.bool(*value));
        let integers: &[i64] = if let Self::Integers(values) = self {
            values
        } else {
            &[]
        };
        writer.count(integers.len());
        integers.iter().for_each(|value| writer.i64(*value));
        let doubles: &[f64] = if let Self::Doubles(values) = self {
            values
        } else {
            &[]
        };
        writer.count(doubles.len());
        doubles.iter().for_each(|value| writer.f64(*value));
        write_texts(
            if let Self::Texts(values) = self {
                values
            } else {
                &[]
            },
            writer,
        );
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        let number = reader.u8()?;
        let bool = Self::Bool(reader.u8()? != 0);
        let integer = Self::Integer(reader.i64()?);
        let double = Self::Double(reader.f64()?);
        let text = Self::Text(reader.text()?.to_owned());
        let bytes = Self::Bytes(read_all(reader, Reader::u8)?);
        let bools = read_all(reader, Reader::u8)?;
        let integers = Self::Integers(read_all(reader, Reader::i64)?);
        let doubles = Self::Doubles(read_all(reader, Reader::f64)?);
        let texts = Self::Texts(read_texts(reader)?);
        Ok(match number {
            1 => bool,
            2 => integer,
            3 => double,
            4 => text,
            5 => bytes,
            6 => Self::Bools(bools.iter().map(|value| *value != 0).collect()),
            7 => integers,
            8 => doubles,
            9 => texts,
            _ => Self::NotSet,
        })
    }
}

/// Items of a sequence, as many as are there: none is made room for before.
fn read_all<'a, T>(
    reader: &mut Reader<'a>,
    read: impl Fn(&mut Reader<'a>) -> Result<T, CdrError>,
) -> Result<Vec<T>, CdrError> {
    let mut items = Vec::new();
    for _ in 0..reader.u32()? {
        items.push(read(reader)?);
    }
    Ok(items)
}

fn read_texts(reader: &mut Reader<'_>) -> Result<Vec<String>, CdrError> {
    read_all(reader, |reader| reader.text().map(str::to_owned))
}

fn write_texts(texts: &[String], writer: &mut Writer<'_>) {
    writer.count(texts.len());
    texts.iter().for_each(|text| writer.text(text));
}

/// What a client asks, for each of [`PARAMETER_SERVICES`].
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Names that begin so, with so many more parts; 0 for any number.
    List(Vec<String>, u64),
    /// Values.
    Get(Vec<String>),
    /// Types.
    Types(Vec<String>),
    /// Descriptions.
    Describe(Vec<String>),
    /// Each is set, or is not.
    Set(Vec<(String, Value)>),
    /// All are set, or none.
    SetAll(Vec<(String, Value)>),
}

impl Request {
    /// Reads the request to the service of that place in [`PARAMETER_SERVICES`].
    ///
    /// # Errors
    /// The message is none.
    pub fn read(service: usize, message: &[u8]) -> Result<Self, CdrError> {
        let mut reader = Reader::new(message)?;
        if service >= 4 {
            let parameters = read_all(&mut reader, |reader| {
                Ok((reader.text()?.to_owned(), Value::read(reader)?))
            })?;
            return Ok(match service {
                4 => Self::Set(parameters),
                _ => Self::SetAll(parameters),
            });
        }
        let names = read_texts(&mut reader)?;
        Ok(match service {
            0 => Self::List(names, reader.i64()? as u64),
            1 => Self::Get(names),
            2 => Self::Types(names),
            _ => Self::Describe(names),
        })
    }
}

/// What a parameter is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Its name.
    pub name: String,
    /// That of its value.
    pub type_number: u8,
    /// For people.
    pub text: String,
    /// What it may be; for people.
    pub constraints: String,
    /// It cannot be set.
    pub read_only: bool,
}

/// What a client is answered.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// Names.
    List(Vec<String>),
    /// Values.
    Get(Vec<Value>),
    /// Types.
    Types(Vec<u8>),
    /// Descriptions.
    Describe(Vec<Description>),
    /// For each, whether it was set, or why not.
    Set(Vec<Result<(), String>>),
    /// Whether all were set, or why none.
    SetAll(Result<(), String>),
}

impl Reply {
    /// Encodes it.
    pub fn encode(&self, message: &mut Vec<u8>) {
        let mut writer = Writer::new(message);
        match self {
            Self::List(names) => {
                write_texts(names, &mut writer);
                let prefixes = names.iter().filter_map(|name| name.rsplit_once('.'));
                let mut prefixes: Vec<String> = prefixes.map(|(above, _)| above.into()).collect();
                prefixes.dedup();
                write_texts(&prefixes, &mut writer);
            }
            Self::Get(values) => {
                writer.count(values.len());
                values.iter().for_each(|value| value.write(&mut writer));
            }
            Self::Types(types) => {
                writer.count(types.len());
                writer.raw(types);
            }
            Self::Describe(all) => {
                writer.count(all.len());
                for one in all {
                    writer.text(&one.name);
                    writer.u8(one.type_number);
                    writer.text(&one.text);
                    writer.text(&one.constraints);
                    writer.bool(one.read_only);
                    // Its type does not change, and it has no ranges.
                    writer.bool(false);
                    writer.count(0);
                    writer.count(0);
                }
            }
            Self::Set(results) => {
                writer.count(results.len());
                results
                    .iter()
                    .for_each(|one| write_result(one, &mut writer));
            }
            Self::SetAll(result) => write_result(result, &mut writer),
        }
    }
}

fn write_result(result: &Result<(), String>, writer: &mut Writer<'_>) {
    writer.bool(result.is_ok());
    writer.text(result.as_ref().err().map_or("", String::as_str));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_those_that_are_none_are_refused() {
        let values = [
            Value::NotSet,
            Value::Bool(true),
            Value::Integer(-3),
            Value::Double(0.5),
            Value::Text("last".to_owned()),
            Value::Bytes(vec![1, 2, 3]),
            Value::Bools(vec![true, false]),
            Value::Integers(vec![1, -1]),
            Value::Doubles(vec![-0.5, 2.0]),
            Value::Texts(vec!["x".to_owned(), String::new()]),
        ];
        let parameters = values.map(|value| (format!("a{}", value.type_number()), value));
        let mut message = Vec::new();
        let mut writer = Writer::new(&mut message);
        writer.count(parameters.len());
        for (name, value) in &parameters {
            writer.text(name);
            value.write(&mut writer);
        }
        let set = Request::Set(parameters.to_vec());
        assert_eq!(Request::read(4, &message), Ok(set));
        for end in 0..message.len() {
            assert!(Request::read(5, &message[..end]).is_err());
        }
        // Lengths that are longer than the message.
        for at in 4..message.len() {
            let mut longer = message.clone();
            longer[at] = 0xff;
            for service in 0..PARAMETER_SERVICES.len() {
                let _ = Request::read(service, &longer);
            }
        }
    }

    /// By hand: the type, and a field for each other type, which is empty.
    #[test]
    fn a_value_has_the_bytes_of_its_definition() {
        let mut message = Vec::new();
        Reply::Get(vec![Value::Doubles(vec![1.0])]).encode(&mut message);
        let expected = [
            &[0, 1, 0, 0][..],
            // One value; its type, and a truth value.
            &[1, 0, 0, 0, 8, 0, 0, 0],
            // A whole number and a number, aligned to 8.
            &[0; 16],
            // A text, and three sequences.
            &[1, 0, 0, 0, 0, 0, 0, 0],
            &[0; 12],
            // One number, and no texts.
            &[1, 0, 0, 0],
            &1.0_f64.to_le_bytes(),
            &[0; 4],
        ];
        assert_eq!(message, expected.concat());
    }
}
