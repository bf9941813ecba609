//! A regular grid of samples in blocks, and a field on it of which only the interesting blocks are stored.

use nalgebra::{Point3, Vector3};

/// Samples along a side of a block.
pub(crate) const SIDE: usize = 8;
/// Samples of a block.
pub(crate) const VOXELS: usize = SIDE * SIDE * SIDE;

/// Where the samples are: `origin + spacing (i, j, k)`, in blocks of 8 x 8 x 8.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Lattice {
    pub origin: Point3<f64>,
    pub spacing: f64,
    /// Blocks along x, y, z.
    pub blocks: [usize; 3],
}

impl Lattice {
    /// Number of blocks.
    pub fn count(&self) -> usize {
        self.blocks.iter().product()
    }

    /// Position of a block among the blocks.
    pub fn block_at(&self, block: usize) -> [usize; 3] {
        let [nx, ny, _] = self.blocks;
        [block % nx, block / nx % ny, block / (nx * ny)]
    }

    pub fn block_index(&self, at: [usize; 3]) -> usize {
        (at[2] * self.blocks[1] + at[1]) * self.blocks[0] + at[0]
    }

    /// The first sample of a block.
    pub fn first_voxel(&self, block: usize) -> [usize; 3] {
        self.block_at(block).map(|b| b * SIDE)
    }

    /// The point `at` samples after the first one of a block.
    pub fn point(&self, block: usize, at: Vector3<f64>) -> Point3<f64> {
        let first = Vector3::from(self.first_voxel(block).map(|x| x as f64));
        self.origin + (first + at) * self.spacing
    }

    /// Block and local number of the sample at `at` (0 to 8 along each axis) from the first one of a block.
    /// Beyond the last block: the block itself and its last layer, which is never asked for by cells that are cut.
    pub fn neighbour(&self, block: usize, at: [usize; 3]) -> (usize, usize) {
        let (mut home, mut inner) = (self.block_at(block), at);
        for k in 0..3 {
            if at[k] == SIDE {
                let next = home[k] + 1 < self.blocks[k];
                home[k] += usize::from(next);
                inner[k] = if next { 0 } else { SIDE - 1 };
            }
        }
        (self.block_index(home), (inner[2] * SIDE + inner[1]) * SIDE + inner[0])
    }

    /// Block and local number of a sample.
    pub fn locate(&self, voxel: [u32; 3]) -> (usize, usize) {
        let v = voxel.map(|x| x as usize);
        let inner = v.map(|x| x % SIDE);
        (self.block_index(v.map(|x| x / SIDE)), (inner[2] * SIDE + inner[1]) * SIDE + inner[0])
    }
}

/// Signed values on a lattice, negative inside: constant in most blocks.
#[derive(Debug, Clone)]
pub(crate) struct Field {
    pub lattice: Lattice,
    pub blocks: Vec<FieldBlock>,
}

#[derive(Debug, Clone)]
pub(crate) enum FieldBlock {
    Constant(f32),
    Samples(Box<[f32; VOXELS]>),
}

impl Field {
    /// The row of 9 samples along x at `y` and `z` (0 to 8) from the first sample of a block.
    pub fn row_near(&self, block: usize, [y, z]: [usize; 2], out: &mut [f32]) {
        let (row, last) = out.split_at_mut(SIDE);
        let (home, first) = self.lattice.neighbour(block, [0, y, z]);
        match &self.blocks[home] {
            FieldBlock::Constant(value) => row.fill(*value),
            FieldBlock::Samples(values) => row.copy_from_slice(&values[first..first + SIDE]),
        }
        let (home, first) = self.lattice.neighbour(block, [SIDE, y, z]);
        last.fill(match &self.blocks[home] {
            FieldBlock::Constant(value) => *value,
            FieldBlock::Samples(values) => values[first],
        });
    }

    /// The value at the sample nearest to a point; `None` outside the lattice.
    pub fn nearest(&self, p: &Point3<f64>) -> Option<f32> {
        let at = (p - self.lattice.origin) / self.lattice.spacing;
        let voxel = [0, 1, 2].map(|k| at[k].round());
        let inside = (0..3).all(|k| voxel[k] >= 0.0 && voxel[k] < (self.lattice.blocks[k] * SIDE) as f64);
        let (block, sample) = inside.then(|| self.lattice.locate(voxel.map(|v| v as u32)))?;
        Some(match &self.blocks[block] {
            FieldBlock::Constant(value) => *value,
            FieldBlock::Samples(values) => values[sample],
        })
    }

    /// Whether the cells of a block can be cut: not if it and the blocks after it are constant with one sign.
    pub fn may_have_surface(&self, block: usize) -> bool {
        let sign = |at: [usize; 3]| match &self.blocks[self.lattice.neighbour(block, at).0] {
            FieldBlock::Constant(value) => Some(*value < 0.0),
            FieldBlock::Samples(_) => None,
        };
        let own = sign([0; 3]);
        own.is_none() || (1..8).any(|c| sign([c & 1, c >> 1 & 1, c >> 2].map(|b| b * SIDE)) != own)
    }
}
