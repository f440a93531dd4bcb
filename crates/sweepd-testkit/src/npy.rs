//! Arrays of numbers in NumPy's .npy format, version 1.0.

use std::path::Path;

/// An array in C order.
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

/// Reads an array of little-endian f4, f8 or u2.
pub fn read(path: &Path) -> Array {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00", "{}", path.display());
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let head = std::str::from_utf8(&bytes[10..start]).unwrap();
    let field = |name: &str, end: char| {
        let at = head.find(&format!("'{name}': ")).unwrap() + name.len() + 4;
        head[at..].split(end).next().unwrap()
    };
    assert_eq!(field("fortran_order", ','), "False");
    let shape = field("shape", ')')
        .trim_start_matches('(')
        .split(',')
        .filter_map(|n| n.trim().parse().ok())
        .collect();
    let data = &bytes[start..];
    let values = match field("descr", ',').trim_matches('\'') {
        "<f4" => data
            .as_chunks()
            .0
            .iter()
            .map(|b| f64::from(f32::from_le_bytes(*b)))
            .collect(),
        "<f8" => data
            .as_chunks()
            .0
            .iter()
            .map(|b| f64::from_le_bytes(*b))
            .collect(),
        "<u2" => data
            .as_chunks()
            .0
            .iter()
            .map(|b| f64::from(u16::from_le_bytes(*b)))
            .collect(),
        other => panic!("{}: {other} is not read here", path.display()),
    };
    Array { shape, values }
}

impl Array {
    /// The same as an image of ours: column after column.
    pub fn by_column(&self) -> Vec<f32> {
        let [rows, columns] = self.shape[..] else {
            panic!("no image")
        };
        (0..rows * columns)
            .map(|i| self.values[i % rows * columns + i / rows] as f32)
            .collect()
    }
}
