//! Arrays of numbers in the safetensors format: eight bytes with the length of a JSON header, the header with type, shape and byte
//! range of each array, then the raw little-endian values, so that other programs can read the weights.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Key of the format's free text, and of our one entry in it.
const METADATA: &str = "__metadata__";
const NOTE: &str = "drex";

/// Name, shape and row-major values of one array.
pub(crate) type Array<'a> = (String, [usize; 2], &'a [f32]);

/// A safetensors file of these arrays, with a text of ours if there is one. The same content gives the same bytes.
pub(crate) fn to_bytes(arrays: &[Array<'_>], note: Option<&str>) -> Vec<u8> {
    let mut header = BTreeMap::new();
    let mut data = Vec::with_capacity(arrays.iter().map(|a| 4 * a.2.len()).sum());
    for (name, shape, values) in arrays {
        let start = data.len();
        data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        let entry = Entry { dtype: "F32".into(), shape: shape.to_vec(), data_offsets: [start, data.len()] };
        header.insert(name.clone(), serde_json::to_value(entry).unwrap_or_default());
    }
    if let Some(note) = note {
        header.insert(METADATA.to_owned(), serde_json::json!({ NOTE: note }));
    }
    let mut header = serde_json::to_vec(&header).unwrap_or_default();
    // The format wants the values aligned to eight bytes and allows spaces after the header.
    header.resize(header.len().next_multiple_of(8), b' ');
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.append(&mut header);
    bytes.append(&mut data);
    bytes
}

/// The text that [`to_bytes`] put beside the arrays.
///
/// # Errors
/// A sentence that says what is wrong.
pub(crate) fn note(bytes: &[u8]) -> Result<String, String> {
    let (header, _) = split(bytes)?;
    let text = header.get(METADATA).and_then(|m| m.get(NOTE)).and_then(|n| n.as_str());
    text.map(str::to_owned).ok_or_else(|| "the header does not say what the arrays are".into())
}

/// Reads a safetensors file that holds exactly the arrays of these names and shapes as F32, in the order asked for.
///
/// # Errors
/// A sentence that says what is wrong. No input panics or allocates more than its own length.
pub(crate) fn from_bytes(expected: &[(String, [usize; 2])], bytes: &[u8]) -> Result<Vec<Vec<f32>>, String> {
    let (mut header, data) = split(bytes)?;
    header.remove(METADATA);
    let mut arrays = Vec::new();
    let mut used = 0;
    for (name, shape) in expected {
        let entry = header.remove(name).ok_or_else(|| format!("array '{name}' is missing"))?;
        let entry: Entry = serde_json::from_value(entry).map_err(|e| format!("array '{name}': {e}"))?;
        if entry.dtype != "F32" || entry.shape != *shape {
            return Err(format!("array '{name}' is {} {:?}, not F32 {shape:?}", entry.dtype, entry.shape));
        }
        let [start, end] = entry.data_offsets;
        let values = data.get(start..end).filter(|v| v.len() == 4 * shape[0] * shape[1]);
        let values = values
            .ok_or_else(|| format!("array '{name}' has bytes {start} .. {end}, which do not hold {shape:?} numbers"))?;
        used += values.len();
        let values: Vec<f32> = values.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(format!("array '{name}' holds {} at position {at}", values[at]));
        }
        arrays.push(values);
    }
    if let Some(name) = header.keys().next() {
        return Err(format!("array '{name}' does not belong here"));
    }
    if used != data.len() {
        return Err(format!("the arrays take {used} bytes but the file holds {}", data.len()));
    }
    Ok(arrays)
}

type Header = BTreeMap<String, serde_json::Value>;

fn split(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let (length, rest) = bytes.split_first_chunk::<8>().ok_or("the file is shorter than its header")?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|&l| l <= rest.len());
    let (header, data) = rest.split_at(length.ok_or("the header is longer than the file")?);
    let header = serde_json::from_slice(header).map_err(|e| format!("the header is no JSON object ({e})"))?;
    Ok((header, data))
}

/// What the header of a safetensors file says about one array.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}
