//! Golden arrays: a reader of uncompressed npz files, and the comparison the goldens ask for.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc, missing_docs, unreachable_pub)] // shared by several test files

use std::collections::BTreeMap;
use std::path::PathBuf;

/// One array of a golden file, as f64 whatever it was stored as.
#[derive(Debug, Clone)]
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

/// The arrays of a golden file by name.
#[derive(Debug)]
pub struct Golden {
    pub name: String,
    arrays: BTreeMap<String, Array>,
}

/// The shared folder of reference data; prints why and gives `None` where there is none.
pub fn shared(folder: &str) -> Option<PathBuf> {
    match std::env::var_os("DREX_SHARED") {
        Some(root) => Some(PathBuf::from(root).join("data").join(folder)),
        None => {
            eprintln!("skipped: DREX_SHARED is not set");
            None
        }
    }
}

impl Golden {
    pub fn load(name: &str) -> Option<Self> {
        let bytes = std::fs::read(shared("golden/splat")?.join(format!("{name}.npz"))).unwrap();
        Some(Self { name: name.into(), arrays: parse_npz(&bytes) })
    }

    pub fn get(&self, name: &str) -> &Array {
        self.arrays.get(name).unwrap_or_else(|| panic!("{}: no array {name}; has {:?}", self.name, self.arrays.keys()))
    }

    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    pub fn f32s(&self, name: &str) -> Vec<f32> {
        self.get(name).values.iter().map(|&v| v as f32).collect()
    }

    pub fn scalar(&self, name: &str) -> f64 {
        self.get(name).values[0]
    }

    /// Compares by the two rules of the goldens' README: e = max |ours - file| / max |file| at most `limit`, and
    /// |ours - file| <= `element` (|file| + 1e-3 max |file|) element by element. `which` tells which entries count.
    pub fn compare(&self, name: &str, ours: &[f32], limit: f64, element: f64, which: impl Fn(usize) -> bool) {
        let file = self.get(name);
        assert_eq!(file.values.len(), ours.len(), "{}/{name}: length", self.name);
        let largest = file.values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let (mut worst, mut worst_element, mut at) = (0.0_f64, 0.0_f64, 0);
        for (i, (&theirs, &mine)) in file.values.iter().zip(ours).enumerate().filter(|(i, _)| which(*i)) {
            let off = (f64::from(mine) - theirs).abs();
            assert!(off.is_finite(), "{}/{name}[{i}]: ours {mine}, golden {theirs}", self.name);
            if off / largest > worst {
                (worst, at) = (off / largest, i);
            }
            worst_element = worst_element.max(off / (theirs.abs() + 1e-3 * largest));
        }
        eprintln!(
            "{}/{name}: {worst:.1e} of the largest ({limit:.0e}), element by element {worst_element:.1e} ({element:.0e})",
            self.name
        );
        assert!(
            worst <= limit,
            "{}/{name}[{at}]: ours {}, golden {}: {worst:.2e} > {limit:.0e}",
            self.name,
            ours[at],
            file.values[at]
        );
        assert!(
            worst_element <= element,
            "{}/{name}: element by element {worst_element:.2e} > {element:.0e}",
            self.name
        );
    }
}

/// Reads a zip of npy files stored without compression; sizes come from the central directory.
pub fn parse_npz(bytes: &[u8]) -> BTreeMap<String, Array> {
    npz_members(bytes).into_iter().map(|(name, bytes)| (name, parse_npy(bytes))).collect()
}

/// The npy files in such a zip by name.
pub fn npz_members(bytes: &[u8]) -> BTreeMap<String, &[u8]> {
    let u16_at = |p: usize| u16::from_le_bytes(bytes[p..p + 2].try_into().unwrap()) as usize;
    let u32_at = |p: usize| u32::from_le_bytes(bytes[p..p + 4].try_into().unwrap()) as usize;
    let end = (0..=bytes.len() - 22).rev().find(|&p| &bytes[p..p + 4] == b"PK\x05\x06").unwrap();
    let (count, mut p) = (u16_at(end + 10), u32_at(end + 16));
    let mut arrays = BTreeMap::new();
    for _ in 0..count {
        assert_eq!(u16_at(p + 10), 0, "compressed member");
        let (size, name_len, extra, comment, local) =
            (u32_at(p + 24), u16_at(p + 28), u16_at(p + 30), u16_at(p + 32), u32_at(p + 42));
        let name = std::str::from_utf8(&bytes[p + 46..p + 46 + name_len]).unwrap().trim_end_matches(".npy").to_owned();
        let start = local + 30 + u16_at(local + 26) + u16_at(local + 28);
        arrays.insert(name, &bytes[start..start + size]);
        p += 46 + name_len + extra + comment;
    }
    arrays
}

fn parse_npy(bytes: &[u8]) -> Array {
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let len = u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
    let header = std::str::from_utf8(&bytes[10..10 + len]).unwrap();
    assert!(header.contains("'fortran_order': False"));
    let after = |key: &str| header.split(key).nth(1).unwrap();
    let kind = after("'descr': '").split('\'').next().unwrap();
    let shape: Vec<usize> =
        after("'shape': (").split(')').next().unwrap().split(',').filter_map(|s| s.trim().parse().ok()).collect();
    let data = &bytes[10 + len..];
    let values = match kind {
        "<f4" => data.chunks_exact(4).map(|c| f64::from(f32::from_le_bytes(c.try_into().unwrap()))).collect(),
        "<f8" => data.chunks_exact(8).map(|c| f64::from_le_bytes(c.try_into().unwrap())).collect(),
        "<i4" => data.chunks_exact(4).map(|c| f64::from(i32::from_le_bytes(c.try_into().unwrap()))).collect(),
        "<i8" => data.chunks_exact(8).map(|c| i64::from_le_bytes(c.try_into().unwrap()) as f64).collect(),
        "|u1" => data.iter().map(|&c| f64::from(c)).collect(),
        other => panic!("npy type {other}"),
    };
    Array { shape, values }
}
