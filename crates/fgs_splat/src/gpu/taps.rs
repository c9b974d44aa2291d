//! Unrolls the loop over the taps of SSIM's window in the shaders' source.
//!
//! A driver that does not unroll the loop itself spills a constant array of weights to thread-local
//! memory. So a shader writes the loop as one marked line, which is repeated for each tap with the
//! weight as a literal:
//! `#each_tap sum += {weight} * rows[first + {tap}];`

use crate::losses::{TAPS, window};

const MARK: &str = "#each_tap ";

/// A shader's source with every marked line repeated for each tap.
pub fn unroll_taps(source: &str) -> String {
    let half = window();
    let mut unrolled = String::with_capacity(source.len());
    for line in source.split_inclusive('\n') {
        let Some(statement) = line.trim_start().strip_prefix(MARK) else {
            unrolled.push_str(line);
            continue;
        };
        for tap in 0..TAPS {
            let weight = format!("{:?}", half[tap.min(TAPS - 1 - tap)]);
            let tap = format!("{tap}u");
            unrolled.push_str(
                &statement
                    .replace("{weight}", &weight)
                    .replace("{tap}", &tap),
            );
        }
    }
    unrolled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marked_line_becomes_one_for_each_tap() {
        let unrolled = unroll_taps("before\n    #each_tap {tap} {weight}\nafter\n");
        let lines: Vec<&str> = unrolled.lines().collect();
        assert_eq!((lines[0], lines[12], lines.len()), ("before", "after", 13));
        let weights: Vec<f32> = (0..11)
            .map(|tap| {
                let weight = lines[1 + tap].strip_prefix(&format!("{tap}u ")).unwrap();
                weight.parse().unwrap()
            })
            .collect();
        assert!((weights.iter().sum::<f32>() - 1.0).abs() <= 1e-6);
        // exp(-5^2 / (2 * 1.5^2)) and exp(-1 / (2 * 1.5^2)) of the middle one.
        for (tap, ratio) in [(0, 0.003_865_92), (10, 0.003_865_92), (6, 0.800_737_4)] {
            assert!((weights[tap] / weights[5] - ratio).abs() <= 1e-6 * ratio);
        }
    }
}
