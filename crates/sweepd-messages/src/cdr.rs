//! Writes and reads CDR, the format of messages in DDS and in bags: plain (XCDR1, OMG CDR section
//! 15.3), written little-endian.
//!
//! A value lies at a multiple of its size, counted from the end of the 4 bytes of encapsulation. A
//! text has its length in front, the NUL behind it included; a sequence its number of items.

use thiserror::Error;

/// The encapsulation: plain CDR, little-endian, no options.
pub const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Writes one message to the end of a vector. There is no padding behind the last value.
#[derive(Debug)]
pub struct Writer<'a> {
    bytes: &'a mut Vec<u8>,
    /// Where alignment is counted from.
    origin: usize,
}

/// Where a `u32` stands that is to be written later.
#[derive(Clone, Copy, Debug)]
pub struct Place(usize);

macro_rules! number {
    ($($name:ident: $type:ty),*) => {$(
        #[doc = concat!("Writes a `", stringify!($type), "`.")]
        #[inline]
        pub fn $name(&mut self, value: $type) {
            self.align(size_of::<$type>());
            self.bytes.extend_from_slice(&value.to_le_bytes());
        }
    )*};
}

impl<'a> Writer<'a> {
    /// Writes the encapsulation.
    pub fn new(bytes: &'a mut Vec<u8>) -> Self {
        bytes.extend_from_slice(&ENCAPSULATION);
        let origin = bytes.len();
        Self { bytes, origin }
    }

    number!(u8: u8, u32: u32, i32: i32, i64: i64, f32: f32, f64: f64);

    /// Writes a truth value.
    pub fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    /// Writes a text.
    pub fn text(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// Writes the number of items of a sequence. The items are the caller's to write.
    pub fn count(&mut self, items: usize) {
        self.u32(u32::try_from(items).unwrap_or(u32::MAX));
    }

    /// Writes bytes as they are: an array of them, or the items of a sequence of bytes.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Writes a `builtin_interfaces/Time`: nanoseconds since 1970. Times that its 32 bits of
    /// seconds cannot hold become the nearest that they can.
    pub fn time(&mut self, time_ns: i64) {
        let seconds = time_ns.div_euclid(1_000_000_000);
        self.i32(seconds.clamp(i32::MIN.into(), i32::MAX.into()) as i32);
        self.u32(time_ns.rem_euclid(1_000_000_000) as u32);
    }

    /// Writes a `std_msgs/Header`.
    pub fn header(&mut self, time_ns: i64, frame_id: &str) {
        self.time(time_ns);
        self.text(frame_id);
    }

    /// Leaves room for a `u32`.
    pub fn later(&mut self) -> Place {
        self.u32(0);
        Place(self.bytes.len() - 4)
    }

    /// Writes a `u32` where there is room for it.
    pub fn fill(&mut self, place: Place, value: usize) {
        let value = u32::try_from(value).unwrap_or(u32::MAX);
        self.bytes[place.0..place.0 + 4].copy_from_slice(&value.to_le_bytes());
    }

    /// The bytes of the items of a sequence of bytes, to write as a whole: this many, zero.
    pub fn items(&mut self, len: usize) -> &mut [u8] {
        let start = self.bytes.len();
        self.bytes.resize(start + len, 0);
        &mut self.bytes[start..]
    }

    /// Drops bytes at the end.
    pub fn drop_last(&mut self, len: usize) {
        self.bytes.truncate(self.bytes.len() - len);
    }

    #[inline]
    fn align(&mut self, size: usize) {
        let len = self.bytes.len();
        let padded = (len - self.origin).next_multiple_of(size) + self.origin;
        self.bytes.resize(padded, 0);
    }
}

/// Reads one message of either byte order. Each value is checked against the end of the bytes, and
/// nothing is allocated.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    /// Behind the encapsulation.
    bytes: &'a [u8],
    at: usize,
    is_big_endian: bool,
}

/// Why bytes are no message of a type.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum CdrError {
    /// It has another encapsulation.
    #[error("it is no plain CDR")]
    Encapsulation,
    /// It ends too early.
    #[error("it ends within a value")]
    Short,
    /// It has a text that is none.
    #[error("a text of it is no UTF-8 with a NUL behind it")]
    Text,
}

macro_rules! read_number {
    ($($name:ident: $type:ty),*) => {$(
        #[doc = concat!("Reads a `", stringify!($type), "`.")]
        ///
        /// # Errors
        /// [`CdrError::Short`].
        pub fn $name(&mut self) -> Result<$type, CdrError> {
            self.number().map(<$type>::from_le_bytes)
        }
    )*};
}

impl<'a> Reader<'a> {
    /// Reads the encapsulation.
    ///
    /// # Errors
    /// [`CdrError::Encapsulation`].
    pub fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let [0, order @ (0 | 1), _, _, bytes @ ..] = message else {
            return Err(CdrError::Encapsulation);
        };
        Ok(Self {
            bytes,
            at: 0,
            is_big_endian: *order == 0,
        })
    }

    read_number!(u8: u8, u32: u32, i32: i32, i64: i64, f64: f64);

    /// Reads a text.
    ///
    /// # Errors
    /// [`CdrError::Short`], [`CdrError::Text`].
    pub fn text(&mut self) -> Result<&'a str, CdrError> {
        let len = self.u32()? as usize;
        let bytes = self.bytes[self.at..].get(..len).ok_or(CdrError::Short)?;
        self.at += len;
        let text = bytes.strip_suffix(&[0]).ok_or(CdrError::Text)?;
        std::str::from_utf8(text).map_err(|_| CdrError::Text)
    }

    /// Reads a `builtin_interfaces/Time`: nanoseconds since 1970.
    ///
    /// # Errors
    /// [`CdrError::Short`].
    pub fn time(&mut self) -> Result<i64, CdrError> {
        let seconds = i64::from(self.i32()?);
        Ok(seconds * 1_000_000_000 + i64::from(self.u32()?))
    }

    /// Reads a `std_msgs/Header`: nanoseconds since 1970, and the frame.
    ///
    /// # Errors
    /// As [`Reader::text`].
    pub fn header(&mut self) -> Result<(i64, &'a str), CdrError> {
        Ok((self.time()?, self.text()?))
    }

    /// Reads `f64`s.
    ///
    /// # Errors
    /// [`CdrError::Short`].
    pub fn f64s<const COUNT: usize>(&mut self) -> Result<[f64; COUNT], CdrError> {
        let mut values = [0.0; COUNT];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// The bytes of a number, the least significant first.
    fn number<const BYTES: usize>(&mut self) -> Result<[u8; BYTES], CdrError> {
        let at = self.at.next_multiple_of(BYTES);
        let rest = self.bytes.get(at..).ok_or(CdrError::Short)?;
        let mut bytes = *rest.first_chunk().ok_or(CdrError::Short)?;
        self.at = at + BYTES;
        if self.is_big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand, and the second message in the same vector counts from its own start.
    #[test]
    fn values_are_aligned_from_the_encapsulation_on() {
        let mut bytes = vec![9];
        let mut writer = Writer::new(&mut bytes);
        writer.u8(7);
        writer.text("ab");
        writer.f64(1.0);
        writer.bool(true);
        assert_eq!(bytes[..5], [9, 0, 1, 0, 0]);
        assert_eq!(bytes[5..16], [7, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
        assert_eq!(
            bytes[16..],
            [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xF0, 0x3F, 1]
        );
    }

    #[test]
    fn times_before_1970_and_beyond_32_bits_are_written() {
        let time = |time_ns| {
            let mut bytes = Vec::new();
            Writer::new(&mut bytes).time(time_ns);
            let word = |at: usize| <[u8; 4]>::try_from(&bytes[at..at + 4]).unwrap();
            (i32::from_le_bytes(word(4)), u32::from_le_bytes(word(8)))
        };
        assert_eq!(time(1_700_000_000_000_000_001), (1_700_000_000, 1));
        assert_eq!(time(-1), (-1, 999_999_999));
        assert_eq!(time(i64::MAX), (i32::MAX, 854_775_807));
    }
    /// By hand: each byte order, and what is cut off or is no text.
    #[test]
    fn values_of_both_byte_orders_are_read_and_no_further() {
        let little = *b"\0\x01\0\0\x03\0\0\0ab\0\0\0\0\0\0\0\0\xf0\x3f";
        let big = *b"\0\0\0\0\0\0\0\x03ab\0\0\x3f\xf0\0\0\0\0\0\0";
        let read = |message: &[u8]| {
            let mut reader = Reader::new(message)?;
            let text = reader.text()?.to_owned();
            Ok((text, reader.f64()?))
        };
        assert_eq!(read(&little), Ok(("ab".to_owned(), 1.0)));
        assert_eq!(read(&big), Ok(("ab".to_owned(), 1.0)));
        for len in 0..little.len() {
            assert!(read(&little[..len]).is_err(), "{len}");
        }
        for (at, byte, error) in [
            (1, 3, CdrError::Encapsulation),
            (7, 0xFF, CdrError::Short),
            (4, 2, CdrError::Text),
            (4, 0, CdrError::Text),
            (8, 0xFF, CdrError::Text),
        ] {
            let mut wrong = little;
            wrong[at] = byte;
            assert_eq!(read(&wrong), Err(error), "{at}");
        }
    }
}
