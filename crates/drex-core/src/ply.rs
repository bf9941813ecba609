//! Numbers of PLY files; what is made of them is up to who reads the file.

/// Type of a number in a PLY file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// `char`, `int8`.
    I8,
    /// `uchar`, `uint8`.
    U8,
    /// `short`, `int16`.
    I16,
    /// `ushort`, `uint16`.
    U16,
    /// `int`, `int32`.
    I32,
    /// `uint`, `uint32`.
    U32,
    /// `float`, `float32`.
    F32,
    /// `double`, `float64`.
    F64,
}

impl Scalar {
    /// The type of this name in a header, if it is one.
    pub fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a number.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number at the start of `bytes`; none if there are fewer than [`Scalar::size`].
    pub fn read(self, bytes: &[u8], little_endian: bool) -> Option<f64> {
        let own = bytes.get(..self.size())?;
        // The bits, least significant byte first.
        let mut le = [0; 8];
        for (k, to) in le[..own.len()].iter_mut().enumerate() {
            *to = own[if little_endian { k } else { own.len() - 1 - k }];
        }
        let bits = u64::from_le_bytes(le);
        Some(match self {
            Self::I8 => f64::from(bits as i8),
            Self::U8 => f64::from(bits as u8),
            Self::I16 => f64::from(bits as i16),
            Self::U16 => f64::from(bits as u16),
            Self::I32 => f64::from(bits as i32),
            Self::U32 => f64::from(bits as u32),
            Self::F32 => f64::from(f32::from_bits(bits as u32)),
            Self::F64 => f64::from_bits(bits),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_either_byte_order_are_read() {
        let read = |name: &str, bytes: &[u8], little| Scalar::parse(name).and_then(|s| s.read(bytes, little));
        assert_eq!(read("short", &[0xfe, 0xff], true), Some(-2.0));
        assert_eq!(read("uint16", &[1, 2, 9], false), Some(258.0));
        assert_eq!(read("float", &1.5f32.to_be_bytes(), false), Some(1.5));
        assert_eq!(read("double", &(-0.1f64).to_le_bytes(), true), Some(-0.1));
        assert_eq!(read("int", &[0, 0, 0], true), None, "cut off");
        assert_eq!(read("uchar", &[], true), None);
        assert_eq!(Scalar::parse("half"), None);
    }
}
