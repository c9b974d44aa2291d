//! CDR, in which ROS 2 writes its messages (OMG DDS-XTypes 7.4, plain encoding): numbers lie at multiples
//! of their size, counted from behind the four bytes that say in which order of bytes.
//!
//! Read by hand, since images are megabytes: generic readers take their bytes one by one.

/// What a message is cut short by, or not made of.
#[derive(Debug, PartialEq)]
pub(crate) struct NotCdr;

/// Reads values one after another.
pub(crate) struct CdrReader<'a> {
    bytes: &'a [u8],
    place: usize,
    is_big_endian: bool,
}

impl<'a> CdrReader<'a> {
    /// Of a whole message.
    pub fn new(message: &'a [u8]) -> Result<Self, NotCdr> {
        match message {
            [0, order @ (0 | 1), _, _, bytes @ ..] => Ok(Self {
                bytes,
                place: 0,
                is_big_endian: *order == 0,
            }),
            _ => Err(NotCdr),
        }
    }

    pub fn u8(&mut self) -> Result<u8, NotCdr> {
        self.number::<1>().map(|[byte]| byte)
    }

    pub fn u32(&mut self) -> Result<u32, NotCdr> {
        self.number().map(u32::from_le_bytes)
    }

    pub fn i32(&mut self) -> Result<i32, NotCdr> {
        self.number().map(i32::from_le_bytes)
    }

    pub fn f64(&mut self) -> Result<f64, NotCdr> {
        self.number().map(f64::from_le_bytes)
    }

    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N], NotCdr> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// A sequence of at most `most` numbers.
    pub fn f64_sequence(&mut self, most: u32) -> Result<Vec<f64>, NotCdr> {
        let len = self.u32()?;
        if len > most {
            return Err(NotCdr);
        }
        (0..len).map(|_| self.f64()).collect()
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self) -> Result<&'a [u8], NotCdr> {
        let len = self.u32()?;
        self.take(len as usize)
    }

    /// Text, which ends with a zero that is counted.
    pub fn string(&mut self) -> Result<&'a str, NotCdr> {
        let bytes = self.bytes()?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        str::from_utf8(text).map_err(|_| NotCdr)
    }

    /// The bytes of a number, the least first.
    fn number<const N: usize>(&mut self) -> Result<[u8; N], NotCdr> {
        self.place = self.place.next_multiple_of(N);
        let mut bytes: [u8; N] = self.take(N)?.try_into().map_err(|_| NotCdr)?;
        if self.is_big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn take(&mut self, len: usize) -> Result<&'a [u8], NotCdr> {
        let end = self.place.checked_add(len).ok_or(NotCdr)?;
        let taken = self.bytes.get(self.place..end).ok_or(NotCdr)?;
        self.place = end;
        Ok(taken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_lie_at_multiples_of_their_size() {
        let order = [0, 1, 0, 0];
        let number = [7, 0xaa, 0xaa, 0xaa];
        let text = [3, 0, 0, 0, b'a', b'b', 0, 0xaa, 0xaa, 0xaa, 0xaa, 0xaa];
        let message = [&order, &number, text.as_slice(), &2.0_f64.to_le_bytes()].concat();
        let mut reader = CdrReader::new(&message).unwrap();
        assert_eq!(reader.u8(), Ok(7));
        assert_eq!(reader.string(), Ok("ab"));
        assert_eq!(reader.f64(), Ok(2.0));
        assert_eq!(reader.u8(), Err(NotCdr));
    }

    #[test]
    fn either_order_of_bytes() {
        let mut reader = CdrReader::new(&[0, 0, 0, 0, 0, 0, 1, 2]).unwrap();
        assert_eq!(reader.u32(), Ok(258));
        let mut reader = CdrReader::new(&[0, 1, 0, 0, 2, 1, 0, 0]).unwrap();
        assert_eq!(reader.i32(), Ok(258));
    }

    #[test]
    fn no_length_reaches_beyond_the_message() {
        let message = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2];
        assert_eq!(CdrReader::new(&message).unwrap().bytes(), Err(NotCdr));
        let mut reader = CdrReader::new(&message).unwrap();
        assert_eq!(reader.f64_sequence(14), Err(NotCdr));
        assert!(CdrReader::new(&[0, 7, 0, 0]).is_err() && CdrReader::new(&[0]).is_err());
    }
}
