use fgs_geom::Image;
use fgs_splat::*;
use std::time::Instant;
fn main() {
    for (w, h) in [(1200, 680), (640, 480)] {
        let color = Image::from_fn(w, h, |u, v| {
            [
                ((u * 7 + v * 3) % 97) as f32 / 97.,
                ((u * 5 + v * 11) % 89) as f32 / 89.,
                0.5,
            ]
        });
        let t = Target::new(
            Image::from_fn(w, h, |u, v| {
                [
                    ((u * 6 + v * 3) % 255) as u8,
                    (u % 255) as u8,
                    (v % 255) as u8,
                ]
            }),
            Image::filled(w, h, 2.0),
        )
        .unwrap();
        let d = Image::filled(w, h, 1.9f32);
        let a = Image::filled(w, h, 0.9f32);
        let s = LossSettings::default();
        let mut ts = vec![];
        let mut x = 0.;
        for _ in 0..60 {
            let t0 = Instant::now();
            let l = photometric_loss(&color, &d, &a, &t, &s).unwrap();
            ts.push(t0.elapsed().as_secs_f64() * 1e3);
            x += l.total + l.d_color.data()[77][1] as f64;
        }
        ts.sort_by(f64::total_cmp);
        println!("{w}x{h}: median {:.2} min {:.2} ms ({x})", ts[30], ts[0]);
    }
}
