//! Bytes of binary formats, put together by hand, so that a test can lie in any of their fields.

use std::io::Write;

/// A `.npy` file (NEP 1) whose header says `descr` and `shape`, whatever `data` holds.
pub fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

/// A `.npy` file of 64-bit floats.
pub fn npy_numbers(shape: &str, numbers: &[f64]) -> Vec<u8> {
    npy("<f8", shape, &numbers.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>())
}

/// A zip archive of these members, deflated.
pub fn npz(members: &[(&str, &[u8])]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    // Writing into memory fails only if memory ends; a cut archive is a test case like any other.
    for (name, bytes) in members {
        let _ = archive.start_file(format!("{name}.npy"), options).and_then(|()| Ok(archive.write_all(bytes)?));
    }
    archive.finish().map(std::io::Cursor::into_inner).unwrap_or_default()
}

/// Bytes compressed as gzip.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    // As above.
    let _ = out.write_all(bytes);
    out.finish().unwrap_or_default()
}

/// A GLB of a JSON chunk and a binary chunk.
pub fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut text = json.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let mut out = b"glTF".to_vec();
    for word in [2, total as u32, text.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out
}

/// A binary STL of these triangles whose header says `count`.
pub fn stl(count: u32, triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let mut out = vec![0; 80];
    out.extend(count.to_le_bytes());
    for t in triangles {
        out.extend([0; 12]);
        out.extend(t.as_flattened().iter().flat_map(|c| c.to_le_bytes()));
        out.extend([0; 2]);
    }
    out
}

/// The header of an SPZ file, not compressed.
pub fn spz_header(version: u32, count: u32, degree: u8, bits: u8) -> Vec<u8> {
    let mut out = b"NGSP".to_vec();
    out.extend(version.to_le_bytes());
    out.extend(count.to_le_bytes());
    out.extend([degree, bits, 0, 0]);
    out
}
