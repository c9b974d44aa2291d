//! A map in chunks of records, so that only what has changed is sent again.

use std::sync::Arc;

use fgs_export::splat_record;
use fgs_splat::Gaussians;

/// Bytes of a gaussian: see [`fgs_export::write_splat`].
pub const RECORD_BYTES: usize = 32;
/// Gaussians in a chunk.
const CHUNK: usize = 2048;

/// A change of position that is seen, metres.
const SEEN_M: f32 = 1e-3;
/// A change of size that is seen.
const SEEN_FACTOR: f32 = 1.05;
/// A change of colour, opacity or rotation that is seen, of 255.
const SEEN_BYTES: u8 = 3;
/// A chunk is sent again once more than one in so many of its gaussians looks different.
const SEEN_SHARE: usize = 50;

/// A map as it is to be shown.
#[derive(Default)]
pub struct SplatChunks {
    len: usize,
    chunks: Vec<Chunk>,
    version: u64,
}

struct Chunk {
    /// That of the last change.
    version: u64,
    records: Arc<[u8]>,
}

/// What somebody has been sent.
#[derive(Default)]
pub struct Sent {
    versions: Vec<u64>,
    len: usize,
    /// Where to go on looking.
    next: usize,
}

/// A message: `u32` gaussians of the whole map, `u32` first gaussian, their records.
pub struct Patch {
    header: [u32; 2],
    records: Arc<[u8]>,
}

impl Patch {
    pub fn header(&self) -> [u8; 8] {
        let mut header = [0; 8];
        header[..4].copy_from_slice(&self.header[0].to_le_bytes());
        header[4..].copy_from_slice(&self.header[1].to_le_bytes());
        header
    }

    pub fn records(&self) -> &[u8] {
        &self.records
    }
}

impl SplatChunks {
    /// Takes over a map: chunks that look different, or, if `exactly`, that differ at all.
    pub fn update(&mut self, gaussians: &Gaussians, exactly: bool) {
        self.version += 1;
        self.len = gaussians.len();
        self.chunks.truncate(self.len.div_ceil(CHUNK));
        for first in (0..self.len).step_by(CHUNK) {
            let last = (first + CHUNK).min(self.len);
            let records: Vec<u8> = (first..last)
                .flat_map(|i| splat_record(gaussians, i))
                .collect();
            let old = self.chunks.get_mut(first / CHUNK);
            let new = |records: Vec<u8>| Chunk {
                version: self.version,
                records: records.into(),
            };
            match old {
                None => self.chunks.push(new(records)),
                Some(old) if exactly && *old.records != *records => *old = new(records),
                Some(old) if looks_different(&old.records, &records) => *old = new(records),
                Some(_) => {}
            }
        }
    }

    /// What somebody has not been sent yet, up to about so many bytes; they will have.
    pub fn patches(&self, sent: &mut Sent, max_bytes: usize) -> Vec<Patch> {
        sent.versions.resize(self.chunks.len(), 0);
        let mut patches = Vec::new();
        let mut bytes = 0;
        for _ in 0..self.chunks.len() {
            if bytes >= max_bytes {
                break;
            }
            sent.next = (sent.next + 1) % self.chunks.len();
            let (i, chunk) = (sent.next, &self.chunks[sent.next]);
            if sent.versions[i] < chunk.version {
                sent.versions[i] = chunk.version;
                bytes += chunk.records.len();
                patches.push(self.patch(i * CHUNK, Arc::clone(&chunk.records)));
            }
        }
        if patches.is_empty() && sent.len != self.len {
            patches.push(self.patch(0, Arc::from([])));
        }
        sent.len = self.len;
        patches
    }

    /// Whether somebody has been sent everything.
    pub fn are_sent(&self, sent: &Sent) -> bool {
        let versions = self.chunks.iter().map(|chunk| chunk.version);
        sent.len == self.len && versions.eq(sent.versions.iter().copied())
    }

    fn patch(&self, first: usize, records: Arc<[u8]>) -> Patch {
        // A map of more gaussians would not fit a graphics card.
        let number = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        Patch {
            header: [number(self.len), number(first)],
            records,
        }
    }
}

/// Whether more than a few records differ visibly.
fn looks_different(old: &[u8], new: &[u8]) -> bool {
    let count = new.len() / RECORD_BYTES;
    let pairs = old
        .chunks_exact(RECORD_BYTES)
        .zip(new.chunks_exact(RECORD_BYTES));
    let differing = pairs.filter(|(old, new)| is_seen(old, new)).count();
    old.len() != new.len() || differing > count / SEEN_SHARE
}

fn is_seen(old: &[u8], new: &[u8]) -> bool {
    let float = |record: &[u8], i: usize| {
        let mut bytes = [0; 4];
        bytes.copy_from_slice(&record[4 * i..4 * i + 4]);
        f32::from_le_bytes(bytes)
    };
    let moved = (0..3).any(|i| (float(old, i) - float(new, i)).abs() > SEEN_M);
    let resized = (3..6).any(|i| {
        let factor = float(old, i) / float(new, i);
        !(1.0 / SEEN_FACTOR..=SEEN_FACTOR).contains(&factor)
    });
    let mut bytes = old[24..].iter().zip(&new[24..]);
    moved || resized || bytes.any(|(old, new)| old.abs_diff(*new) > SEEN_BYTES)
}

#[cfg(test)]
mod tests {
    use fgs_splat::Gaussian;

    use super::*;

    fn map(count: usize) -> Gaussians {
        let mut map = Gaussians::default();
        for i in 0..count {
            map.push(&Gaussian {
                mean: [i as f32, 1.0, 2.0],
                quat: [1.0, 0.0, 0.0, 0.0],
                scales: [0.01; 3],
                opacity: 0.9,
                rgb: [0.5; 3],
            });
        }
        map
    }

    /// What somebody sees who has applied the patches.
    fn apply(seen: &mut Vec<u8>, patches: &[Patch]) {
        for patch in patches {
            let [len, first] = patch.header.map(|count| count as usize);
            seen.resize(len * RECORD_BYTES, 0);
            let start = first * RECORD_BYTES;
            seen[start..start + patch.records.len()].copy_from_slice(patch.records());
        }
    }

    fn records(map: &Gaussians) -> Vec<u8> {
        (0..map.len()).flat_map(|i| splat_record(map, i)).collect()
    }

    #[test]
    fn a_map_that_grows_changes_and_shrinks_arrives() {
        let (mut chunks, mut sent, mut seen) =
            (SplatChunks::default(), Sent::default(), Vec::new());
        let mut map = map(3 * CHUNK + 5);
        for step in 0..4 {
            match step {
                1 => map.means[CHUNK..CHUNK + 100].fill([9.0; 3]),
                2 => map.resize(CHUNK + 7),
                3 => map.resize(2 * CHUNK),
                _ => {}
            }
            chunks.update(&map, false);
            assert!(!chunks.are_sent(&sent));
            apply(&mut seen, &chunks.patches(&mut sent, usize::MAX));
            assert!(chunks.are_sent(&sent));
            assert_eq!(seen, records(&map), "{step}");
        }
        chunks.update(&map, false);
        assert!(chunks.patches(&mut sent, usize::MAX).is_empty());
        map.resize(CHUNK);
        chunks.update(&map, false);
        apply(&mut seen, &chunks.patches(&mut sent, usize::MAX));
        assert_eq!(seen, records(&map));
    }

    #[test]
    fn little_is_sent_at_a_time_and_everything_in_turn() {
        let (mut chunks, mut sent, mut seen) =
            (SplatChunks::default(), Sent::default(), Vec::new());
        let map = map(5 * CHUNK);
        chunks.update(&map, false);
        for _ in 0..5 {
            assert!(!chunks.are_sent(&sent));
            let patches = chunks.patches(&mut sent, 1);
            assert_eq!(patches.len(), 1);
            apply(&mut seen, &patches);
        }
        assert_eq!(seen, records(&map));
        assert!(chunks.are_sent(&sent));
    }

    #[test]
    fn what_nobody_sees_waits_for_the_end() {
        let (mut chunks, mut sent) = (SplatChunks::default(), Sent::default());
        let mut map = map(CHUNK);
        chunks.update(&map, false);
        chunks.patches(&mut sent, usize::MAX);
        map.means.iter_mut().for_each(|mean| mean[1] += 5e-4);
        chunks.update(&map, false);
        assert!(chunks.are_sent(&sent));
        chunks.update(&map, true);
        assert_eq!(chunks.patches(&mut sent, usize::MAX).len(), 1);
    }
}
