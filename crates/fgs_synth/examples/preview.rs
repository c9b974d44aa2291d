//! Writes pictures of rooms: `preview OUT_DIR SEED FRAME...`; prints the time for each.
use std::time::Instant;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let seed: u64 = args[2].parse().unwrap();
    let start = Instant::now();
    let sequence = fgs_synth::Sequence::new(
        seed,
        300,
        fgs_synth::KINECT,
        if std::env::var("KINECT").is_ok() {
            fgs_synth::SensorModel::kinect()
        } else {
            fgs_synth::SensorModel::exact()
        },
    );
    println!("room {:?}", start.elapsed());
    for frame in &args[3..] {
        let i: usize = frame.parse().unwrap();
        let start = Instant::now();
        let f = sequence.frame(i);
        println!("frame {i}: {:?}", start.elapsed());
        image::save_buffer(
            format!("{}/s{seed}_{i:03}.png", args[1]),
            f.color.data().as_flattened(),
            640,
            480,
            image::ExtendedColorType::Rgb8,
        )
        .unwrap();
        let d: Vec<u8> = f
            .depth_m
            .data()
            .iter()
            .map(|d| (d * 50.0).min(255.0) as u8)
            .collect();
        image::save_buffer(
            format!("{}/d{seed}_{i:03}.png", args[1]),
            &d,
            640,
            480,
            image::ExtendedColorType::L8,
        )
        .unwrap();
    }
}
