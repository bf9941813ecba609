//! Disjoint sets of numbers (union-find).

/// Disjoint sets of the numbers 0 to n - 1; each set is named by its smallest member.
#[derive(Debug, Clone)]
pub struct DisjointSets(Vec<u32>);

impl DisjointSets {
    /// Sets of one number each.
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    /// The smallest member of the set that has `i`.
    pub fn find(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    /// Makes the sets of `i` and `j` one.
    pub fn join(&mut self, i: u32, j: u32) {
        let (i, j) = (self.find(i), self.find(j));
        self.0[i.max(j) as usize] = i.min(j);
    }

    /// A label 0, 1, 2… per number, in the order in which the sets first appear, and how many sets there are.
    pub fn labels(&mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut labels = vec![0; self.0.len()];
        for i in 0..self.0.len() {
            // The smallest member comes first, so that it has its label by then.
            let root = self.find(i as u32) as usize;
            labels[i] = if root == i { count } else { labels[root] };
            count += u32::from(root == i);
        }
        (labels, count as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_named_by_their_smallest_member() {
        let mut sets = DisjointSets::new(6);
        for (i, j) in [(4, 2), (5, 1), (2, 5)] {
            sets.join(i, j);
        }
        assert_eq!([0, 1, 2, 3, 4, 5].map(|i| sets.find(i)), [0, 1, 1, 3, 1, 1]);
        assert_eq!(sets.labels(), (vec![0, 1, 1, 2, 1, 1], 3));
    }
}
