//! Replays what fuzzers found, and tries bytes of its own: random, and changed from the corpus.

#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "a test may panic and print, its helpers too"
)]

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use fgs_fuzz::TARGETS;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fuzz/corpus")
        .join(target);
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    files
        .iter()
        .map(|path| (name(path), fs::read(path).unwrap()))
        .collect()
}

#[test]
fn what_was_found_stays_mended() {
    for (name, target) in TARGETS {
        let corpus = corpus(name);
        assert!(!corpus.is_empty(), "{name}");
        for (file, bytes) in corpus {
            let outcome = catch_unwind(AssertUnwindSafe(|| target(&bytes)));
            assert!(outcome.is_ok(), "{name}: {file}");
        }
    }
}

/// As long as `FGS_FUZZ_SECS` says for each target, a moment otherwise.
#[test]
fn made_up_bytes() {
    watch();
    let seconds = std::env::var("FGS_FUZZ_SECS").map_or(0.4, |secs| secs.parse().unwrap());
    for (name, target) in TARGETS {
        let corpus: Vec<Vec<u8>> = corpus(name).into_iter().map(|(_, bytes)| bytes).collect();
        let mut rng = Pcg64Mcg::seed_from_u64(seconds as u64);
        let (start, mut count) = (Instant::now(), 0_u64);
        while start.elapsed() < Duration::from_secs_f64(seconds) {
            let bytes = made_up(&corpus, &mut rng);
            *NOW.lock().unwrap() = Some((Instant::now(), name, bytes.clone()));
            if catch_unwind(AssertUnwindSafe(|| target(&bytes))).is_err() {
                panic!("{name}: see {}", keep(name, &bytes).display());
            }
            count += 1;
        }
        eprintln!("{name}: {count} executions");
    }
    *NOW.lock().unwrap() = None;
}

/// What is being executed, since when.
static NOW: Mutex<Option<(Instant, &str, Vec<u8>)>> = Mutex::new(None);

/// Ends the program when an execution hangs.
fn watch() {
    std::thread::spawn(|| {
        loop {
            std::thread::sleep(Duration::from_secs(1));
            if let Some((start, name, bytes)) = &*NOW.lock().unwrap()
                && start.elapsed() > Duration::from_secs(30)
            {
                eprintln!("{name} hangs: see {}", keep(name, bytes).display());
                std::process::exit(1);
            }
        }
    });
}

fn keep(name: &str, bytes: &[u8]) -> PathBuf {
    let path = std::env::temp_dir().join(format!("fgs-fuzz-{name}"));
    fs::write(&path, bytes).unwrap();
    path
}

/// A file of the corpus, cut, joined with another, with bytes and numbers changed; or just bytes.
fn made_up(corpus: &[Vec<u8>], rng: &mut Pcg64Mcg) -> Vec<u8> {
    const NUMBERS: [&[u8]; 10] = [
        b"-1",
        b"0",
        b"nan",
        b"1e308",
        b"-1e-308",
        b"inf",
        b"99999999999999999999",
        b"4294967296",
        b"\n",
        b" ",
    ];
    if rng.random_ratio(1, 20) {
        let len = rng.random_range(0..200);
        return (0..len).map(|_| rng.random()).collect();
    }
    let mut bytes = corpus[rng.random_range(0..corpus.len())].clone();
    for _ in 0..rng.random_range(1..8) {
        if bytes.is_empty() {
            return bytes;
        }
        let place = rng.random_range(0..bytes.len());
        match rng.random_range(0..7) {
            0 => bytes[place] = rng.random(),
            1 => bytes[place] ^= 1 << rng.random_range(0..8),
            2 => bytes.truncate(place),
            3 => {
                let number = NUMBERS[rng.random_range(0..NUMBERS.len())];
                bytes.splice(place..place, number.iter().copied());
            }
            4 => {
                let end = (place + rng.random_range(1..20)).min(bytes.len());
                bytes.drain(place..end);
            }
            5 => {
                let end = (place + rng.random_range(1..60)).min(bytes.len());
                let part = bytes[place..end].to_vec();
                bytes.splice(place..place, part);
            }
            _ => {
                let other = &corpus[rng.random_range(0..corpus.len())];
                let from = rng.random_range(0..=other.len());
                bytes.truncate(place);
                bytes.extend_from_slice(&other[from..]);
            }
        }
    }
    bytes
}
