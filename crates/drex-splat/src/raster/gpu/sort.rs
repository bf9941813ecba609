//! A stable radix sort and a prefix sum on the GPU, both in a fixed order.

use drex_core::Result;
use drex_core::gpu::{Buffer, Device, Kernel, Pass, blocks, line};

/// Keys that a thread counts and moves; as in the shader.
const RUN: u64 = 32;
/// Bits that a pass sorts by, and the digits they make.
const BITS: u32 = 4;
const DIGITS: u64 = 1 << BITS;
/// Numbers that a workgroup sums.
const SCAN_BLOCK: u64 = 2048;

/// The kernels.
#[derive(Debug, Clone)]
pub(super) struct Sorter {
    count_digits: Kernel,
    scatter: Kernel,
    scan_blocks: Kernel,
    add_blocks: Kernel,
}

impl Sorter {
    pub fn new(device: &Device) -> Self {
        let module = device.module("sort", include_str!("shaders/sort.wgsl"));
        let kernel = |entry| device.kernel(&module, entry);
        Self {
            count_digits: kernel("count_digits"),
            scatter: kernel("scatter"),
            scan_blocks: kernel("scan_blocks"),
            add_blocks: kernel("add_blocks"),
        }
    }

    /// Sorts the `len` first keys by their `bits` low bits, and the values with them; both end in the given buffers.
    pub fn sort(
        &self,
        device: &Device,
        pass: &mut Pass<'_>,
        (keys, values): (&Buffer, &Buffer),
        len: u64,
        bits: u32,
    ) -> Result<()> {
        let threads = len.div_ceil(RUN);
        let table = device.storage("counts of digits", DIGITS * threads)?;
        let spare = (device.storage("keys to sort", len)?, device.storage("values to sort", len)?);
        // An even number of passes, so that the last one writes to where the first one read.
        let passes = bits.div_ceil(BITS).next_multiple_of(2);
        let (mut from, mut to) = ((keys, values), (&spare.0, &spare.1));
        for k in 0..passes {
            let step = device.uniform(&[len as u32, threads as u32, BITS * k, 0]);
            let grid = line(threads);
            device.run(pass, &self.count_digits, &[(0, &step), (1, from.0), (3, &table)], grid);
            self.scan(device, pass, &table, DIGITS * threads)?;
            let buffers = [(0, &step), (1, from.0), (2, from.1), (3, &table), (4, to.0), (5, to.1)];
            device.run(pass, &self.scatter, &buffers, grid);
            std::mem::swap(&mut from, &mut to);
        }
        Ok(())
    }

    /// Replaces each of the `len` first numbers by the sum of those before it, at most `u32::MAX`.
    pub fn scan(&self, device: &Device, pass: &mut Pass<'_>, numbers: &Buffer, len: u64) -> Result<()> {
        let count = len.div_ceil(SCAN_BLOCK);
        let totals = device.storage("sums of blocks", count)?;
        let step = device.uniform(&[len as u32, 0, 0, 0]);
        device.run(pass, &self.scan_blocks, &[(0, &step), (6, numbers), (7, &totals)], blocks(count));
        if count > 1 {
            self.scan(device, pass, &totals, count)?;
            device.run(pass, &self.add_blocks, &[(0, &step), (6, numbers), (7, &totals)], line(len));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device() -> Option<Device> {
        match Device::new() {
            Ok(device) => Some(device),
            Err(e) if std::env::var_os("DREX_REQUIRE_GPU").is_none() => {
                eprintln!("skipped: {e}");
                None
            }
            Err(e) => panic!("{e}"),
        }
    }

    fn noise(len: usize, bits: u32) -> Vec<u32> {
        let mut state = 1_u32;
        std::iter::repeat_with(|| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 3).wrapping_mul(2_654_435_761) >> (32 - bits)
        })
        .take(len)
        .collect()
    }

    #[test]
    fn sorts_and_keeps_the_order_of_equal_keys() {
        let Some(device) = device() else { return };
        let sorter = Sorter::new(&device);
        for (len, bits) in [(1_usize, 32), (31, 5), (1000, 3), (70_001, 9), (40_000, 32)] {
            let keys = noise(len, bits);
            let values: Vec<u32> = (0..len as u32).collect();
            let buffers = [&keys, &values].map(|data| {
                let buffer = device.storage("test", len as u64).unwrap();
                device.write(&buffer, 0, data);
                buffer
            });
            device.submit(|pass| sorter.sort(&device, pass, (&buffers[0], &buffers[1]), len as u64, bits)).unwrap();
            let mut truth: Vec<(u32, u32)> = keys.into_iter().zip(values).collect();
            truth.sort_by_key(|(key, _)| *key);
            let sorted: [Vec<u32>; 2] = [0, 1].map(|b| device.read(&buffers[b], 0, len).unwrap());
            assert!(truth.iter().map(|t| t.0).eq(sorted[0].iter().copied()), "{len} keys of {bits} bits");
            assert!(truth.iter().map(|t| t.1).eq(sorted[1].iter().copied()), "{len} values, {bits} bits");
        }
    }

    #[test]
    fn sums_that_overflow_stay_at_the_largest_number() {
        let Some(device) = device() else { return };
        let sorter = Sorter::new(&device);
        let buffer = device.storage("test", 5000).unwrap();
        device.write(&buffer, 0, &vec![1_u32 << 20; 5000]);
        device.submit(|pass| sorter.scan(&device, pass, &buffer, 5000)).unwrap();
        let sums: Vec<u32> = device.read(&buffer, 0, 5000).unwrap();
        assert_eq!([sums[4095], sums[4096], sums[4999]], [4095 << 20, u32::MAX, u32::MAX]);
    }

    #[test]
    fn sums_what_comes_before_over_several_levels() {
        let Some(device) = device() else { return };
        let sorter = Sorter::new(&device);
        for len in [1_usize, 2048, 2049, 4_500_000] {
            let numbers = noise(len, 6);
            let buffer = device.storage("test", len as u64).unwrap();
            device.write(&buffer, 0, &numbers);
            device.submit(|pass| sorter.scan(&device, pass, &buffer, len as u64)).unwrap();
            let mut sum = 0;
            for (k, ours) in device.read::<u32>(&buffer, 0, len).unwrap().into_iter().enumerate() {
                assert_eq!(ours, sum, "{k} of {len}");
                sum += numbers[k];
            }
        }
    }
}
