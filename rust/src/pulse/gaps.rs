//! Stretches of missing samples in an endless train, in bounded memory.

/// Number of kept stretches; if there are more, the nearest are merged.
const KEPT: usize = 1 << 16;

/// Stretches of missing samples in order, each from its first to one past its last.
#[derive(Debug, Clone, Default)]
pub(super) struct Gaps {
    spans: Vec<(u64, u64)>,
    /// Largest distance of stretches that are merged [samples].
    near: u64,
}

impl Gaps {
    /// Add the next stretch.
    pub(super) fn push(&mut self, gap: (u64, u64)) {
        match self.spans.last_mut() {
            Some(last) if self.near > 0 && gap.0 - last.1 <= self.near => last.1 = gap.1,
            _ => self.spans.push(gap),
        }
        while self.spans.len() > KEPT {
            self.near = (2 * self.near).max(1);
            let near = self.near;
            self.spans.dedup_by(|next, last| {
                let joins = next.0 - last.1 <= near;
                if joins {
                    last.1 = next.1;
                }
                joins
            });
        }
    }

    pub(super) fn spans(&self) -> impl Iterator<Item = (u64, u64)> {
        self.spans.iter().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn however_many_there_are_each_missing_sample_lies_in_one_and_far_ones_stay_apart() {
        let mut gaps = Gaps::default();
        for k in 0..300_000 {
            let start = if k < 299_000 { 2 * k } else { 1000 * k };
            gaps.push((start, start + 1));
        }
        let spans: Vec<_> = gaps.spans().collect();
        assert!(spans.len() <= KEPT);
        assert!(spans.windows(2).all(|pair| pair[0].1 < pair[1].0));
        assert_eq!(spans[0].0, 0);
        assert!(spans[0].1 >= 2 * KEPT as u64);
        assert_eq!(spans[spans.len() - 1], (299_999_000, 299_999_001));
        assert_eq!(spans[spans.len() - 1000], (299_000_000, 299_000_001));
    }

    #[test]
    fn as_many_as_are_kept_stay_as_they_are() {
        let mut gaps = Gaps::default();
        for k in 0..KEPT as u64 {
            gaps.push((2 * k, 2 * k + 1));
        }
        assert!(gaps.spans().eq((0..KEPT as u64).map(|k| (2 * k, 2 * k + 1))));
    }
}
