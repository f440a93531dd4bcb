//! Reads CDR.

/// What is not read yet of a message.
pub struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    pub fn new(message: &'a [u8]) -> Self {
        assert_eq!(message[..4], [0, 1, 0, 0]);
        Self {
            bytes: &message[4..],
            at: 0,
        }
    }

    /// The next bytes, at a multiple of `align`.
    fn take(&mut self, len: usize, align: usize) -> &'a [u8] {
        while !self.at.is_multiple_of(align) {
            assert_eq!(self.bytes[self.at], 0, "padding");
            self.at += 1;
        }
        let taken = &self.bytes[self.at..self.at + len];
        self.at += len;
        taken
    }

    pub fn u8(&mut self) -> u8 {
        self.take(1, 1)[0]
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take(4, 4).try_into().unwrap())
    }

    pub fn f32(&mut self) -> f32 {
        f32::from_bits(self.u32())
    }

    pub fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take(8, 8).try_into().unwrap())
    }

    pub fn text(&mut self) -> &'a str {
        let len = self.u32() as usize;
        let text = self.take(len, 1).strip_suffix(&[0]).unwrap();
        std::str::from_utf8(text).unwrap()
    }

    pub fn bytes(&mut self) -> &'a [u8] {
        let len = self.u32() as usize;
        self.take(len, 1)
    }

    /// Nanoseconds since 1970, and the frame.
    pub fn header(&mut self) -> (i64, &'a str) {
        let (sec, nanosec) = (self.u32() as i32, self.u32());
        (
            i64::from(sec) * 1_000_000_000 + i64::from(nanosec),
            self.text(),
        )
    }

    pub fn end(&self) {
        assert_eq!(self.at, self.bytes.len());
    }
}
