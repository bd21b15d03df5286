//! Stretches of samples that are not finite, in bounded memory.

/// Largest number of kept stretches; further ones are only counted.
const KEPT: usize = 4096;

/// Stretches of missing samples, in order.
#[derive(Debug, Clone, Default)]
pub struct Gaps {
    spans: Vec<(u64, u64)>,
    /// First sample of the open stretch, and one past its last sample so far.
    open: Option<(u64, u64)>,
    count: u64,
}

impl Gaps {
    /// Add a missing sample; indices ascend.
    pub fn missing(&mut self, place: u64) {
        match &mut self.open {
            Some((_, stop)) if *stop == place => *stop += 1,
            _ => {
                self.close();
                self.open = Some((place, place + 1));
            }
        }
    }

    /// End the open stretch, if any.
    pub fn close(&mut self) {
        if let Some(span) = self.open.take() {
            self.count += 1;
            if self.spans.len() < KEPT {
                self.spans.push(span);
            }
        }
    }

    /// The first stretches, each as its first sample and one past its last.
    pub fn spans(&self) -> impl Iterator<Item = (u64, u64)> {
        self.spans.iter().copied().chain(self.open.filter(|_| self.spans.len() < KEPT))
    }

    /// Number of all stretches.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count + u64::from(self.open.is_some())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_make_one_stretch() {
        let mut gaps = Gaps::default();
        for place in [3, 4, 5, 9] {
            gaps.missing(place);
        }
        assert_eq!(gaps.spans().collect::<Vec<_>>(), [(3, 6), (9, 10)]);
        assert_eq!(gaps.count(), 2);
    }

    #[test]
    fn memory_stays_bounded_however_many_there_are() {
        let mut gaps = Gaps::default();
        for k in 0..100_000 {
            gaps.missing(2 * k);
        }
        assert_eq!(gaps.spans().count(), KEPT);
        assert_eq!(gaps.count(), 100_000);
    }
}
