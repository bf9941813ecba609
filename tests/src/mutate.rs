//! Damaged inputs: seeds changed in ways that readers trip over.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Words that numbers of a text are replaced by.
const WORDS: [&str; 16] = [
    "0",
    "-1",
    "1e308",
    "-1e-320",
    "nan",
    "inf",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551616",
    "1000000000",
    "0.5",
    "",
    "null",
    "[[",
    "\u{fffd}",
];
/// Values that binary counts and offsets are replaced by.
const COUNTS: [u64; 10] = [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, u64::MAX / 2, u64::MAX];
/// Longest input, bytes.
const LONGEST: usize = 1 << 16;

/// One to eight changes of one of the `seeds`; now and then two seeds spliced. Nothing if there are no seeds.
pub fn mutated(seeds: &[Vec<u8>], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let Some(seed) = pick(seeds, rng) else { return Vec::new() };
    let mut bytes = seed.clone();
    for _ in 0..rng.random_range(1..=8) {
        change(&mut bytes, seeds, rng);
    }
    bytes.truncate(LONGEST);
    bytes
}

fn pick<'a, T>(list: &'a [T], rng: &mut ChaCha8Rng) -> Option<&'a T> {
    if list.is_empty() { None } else { list.get(rng.random_range(0..list.len())) }
}

fn change(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], rng: &mut ChaCha8Rng) {
    let n = bytes.len();
    if n == 0 {
        bytes.push(rng.random());
        return;
    }
    let at = rng.random_range(0..n);
    let end = (at + 1 + rng.random_range(0..64)).min(n);
    match rng.random_range(0..10) {
        0 => bytes[at] ^= 1 << rng.random_range(0..8),
        1 => bytes[at] = rng.random(),
        2 => bytes.truncate(at),
        3 => drop(bytes.drain(at..end)),
        4 => {
            let copy = bytes[at..end].to_vec();
            for _ in 0..rng.random_range(1..=16) {
                bytes.splice(at..at, copy.iter().copied());
            }
        }
        5 => {
            let to = rng.random_range(0..n);
            let copy = bytes[at..end].to_vec();
            bytes.splice(to..to, copy);
        }
        6 => {
            // A count or an offset, of one to eight bytes.
            let width = 1 << rng.random_range(0..4);
            let value = pick(&COUNTS, rng).copied().unwrap_or_default().to_le_bytes();
            bytes.iter_mut().skip(at).zip(&value[..width]).for_each(|(b, v)| *b = *v);
        }
        7 | 8 => {
            // A number or a word of a text, as a whole.
            let inside = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'+');
            let begin = bytes[..at].iter().rposition(|&b| !inside(b)).map_or(0, |k| k + 1);
            let end = bytes[at..].iter().position(|&b| !inside(b)).map_or(n, |k| at + k);
            let word = pick(&WORDS, rng).copied().unwrap_or_default();
            bytes.splice(begin..end.max(begin), word.bytes());
        }
        _ => {
            if let Some(other) = pick(seeds, rng).filter(|o| !o.is_empty()) {
                bytes.truncate(at);
                bytes.extend_from_slice(&other[rng.random_range(0..other.len())..]);
            }
        }
    }
}
