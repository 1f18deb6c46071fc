//! Kinds of numbers that tables of contents name, and their bytes.

use half::f16;

/// Kind of a parameter or log variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Kind {
    U8,
    U16,
    U32,
    I8,
    I16,
    I32,
    F16,
    F32,
}

use Kind::{F16, F32, I8, I16, I32, U8, U16, U32};

impl Kind {
    /// Its numbers in the tables of log variables and of parameters, its bytes, and its name in C.
    fn facts(self) -> (u8, u8, usize, &'static str) {
        match self {
            U8 => (1, 8, 1, "uint8_t"),
            U16 => (2, 9, 2, "uint16_t"),
            U32 => (3, 10, 4, "uint32_t"),
            I8 => (4, 0, 1, "int8_t"),
            I16 => (5, 1, 2, "int16_t"),
            I32 => (6, 2, 4, "int32_t"),
            F16 => (8, 5, 2, "FP16"),
            F32 => (7, 6, 4, "float"),
        }
    }

    /// Its number in the table of log variables.
    pub(crate) fn log_code(self) -> u8 {
        self.facts().0
    }

    /// The kind of that number in the table of log variables.
    pub(crate) fn from_log_code(code: u8) -> Option<Kind> {
        [U8, U16, U32, I8, I16, I32, F32, F16].into_iter().find(|kind| kind.log_code() == code)
    }

    /// Its number in the table of parameters: size as a power of two, 4 for a float, 8 for no sign.
    pub(crate) fn param_code(self) -> u8 {
        self.facts().1
    }

    /// Bytes of a value.
    pub(crate) fn size(self) -> usize {
        self.facts().2
    }

    /// Its name in C.
    pub fn name(self) -> &'static str {
        self.facts().3
    }

    /// Appends a value; integers are cut off at their range.
    pub(crate) fn write(self, value: f64, out: &mut Vec<u8>) {
        match self {
            U8 => out.push(value as u8),
            I8 => out.extend((value as i8).to_le_bytes()),
            U16 => out.extend((value as u16).to_le_bytes()),
            I16 => out.extend((value as i16).to_le_bytes()),
            U32 => out.extend((value as u32).to_le_bytes()),
            I32 => out.extend((value as i32).to_le_bytes()),
            F16 => out.extend(f16::from_f64(value).to_le_bytes()),
            F32 => out.extend((value as f32).to_le_bytes()),
        }
    }

    /// The value at the start of `bytes`, if they are enough.
    pub(crate) fn read(self, bytes: &[u8]) -> Option<f64> {
        Some(match self {
            U8 => (*bytes.first()?).into(),
            I8 => i8::from_le_bytes(*bytes.first_chunk()?).into(),
            U16 => u16::from_le_bytes(*bytes.first_chunk()?).into(),
            I16 => i16::from_le_bytes(*bytes.first_chunk()?).into(),
            U32 => u32::from_le_bytes(*bytes.first_chunk()?).into(),
            I32 => i32::from_le_bytes(*bytes.first_chunk()?).into(),
            F16 => f16::from_le_bytes(*bytes.first_chunk()?).to_f64(),
            F32 => f32::from_le_bytes(*bytes.first_chunk()?).into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_its_bytes_and_back() {
        for kind in [U8, U16, U32, I8, I16, I32, F16, F32] {
            assert_eq!(Kind::from_log_code(kind.log_code()), Some(kind));
            for value in [0.0, 1.0, 100.0] {
                let mut bytes = Vec::new();
                kind.write(value, &mut bytes);
                assert_eq!(bytes.len(), kind.size());
                assert_eq!(kind.read(&bytes), Some(value), "{kind:?}");
                assert_eq!(kind.read(&bytes[1..]), None, "{kind:?}");
            }
        }
    }
}
