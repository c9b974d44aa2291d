//! Rendered values against the closed form and the reference, and each branch of the blending.

use fgs_geom::{Camera, Image, Intrinsics, Se3, View};
use rand::RngExt;

use super::scenes::{random_gaussians, random_view, rng, thicken, to_f32};
use crate::cpu::{Rasterizer, Real};
use crate::{Gaussians, Rendered, SH0_FACTOR, reference};

/// Sizes of random scenes.
const SIZES: [(usize, usize); 5] = [(1, 1), (17, 33), (33, 17), (16, 16), (40, 25)];

pub fn render<T: Real>(gaussians: &Gaussians<T>, view: &View) -> Rendered<T> {
    let mut rasterizer = Rasterizer::default();
    rasterizer.render(gaussians, view).rendered().clone()
}

/// Colour, depth and alpha of a pixel by its place in the row-major image.
fn values<T: Real>(rendered: &Rendered<T>, i: usize) -> [f64; 5] {
    let [r, g, b] = rendered.color.data()[i];
    [
        r,
        g,
        b,
        rendered.depth_m.data()[i],
        rendered.alpha.data()[i],
    ]
    .map(T::to_f64)
}

#[test]
fn bands_are_the_whole_to_the_last_bit() {
    for (seed, (width, height)) in [(70, 100), (33, 48), (40, 5)].into_iter().enumerate() {
        let mut rng = rng(seed as u64);
        let view = random_view(&mut rng, width, height);
        let gaussians = to_f32(&random_gaussians(&mut rng, &view, 200));
        let whole = render(&gaussians, &view);
        for (max_pixels, most_rows) in [(0, 16), (33 * width, 32), (1_000_000, height)] {
            let mut joined = Rendered::default();
            let mut rasterizer = Rasterizer::default();
            let (mut color, mut depth_m, mut alpha) = (Vec::new(), Vec::new(), Vec::new());
            rasterizer
                .render_bands(&gaussians, &view, max_pixels, |band| {
                    assert!(band.color.height() <= most_rows && band.color.width() == width);
                    color.extend_from_slice(band.color.data());
                    depth_m.extend_from_slice(band.depth_m.data());
                    alpha.extend_from_slice(band.alpha.data());
                    Ok::<_, ()>(())
                })
                .unwrap();
            joined.color = Image::new(width, height, color).unwrap();
            joined.depth_m = Image::new(width, height, depth_m).unwrap();
            joined.alpha = Image::new(width, height, alpha).unwrap();
            assert!(joined == whole, "{width}x{height} {max_pixels}");
        }
    }
}

#[test]
fn tiled_agrees_with_the_reference() {
    let (mut compared, mut skipped) = (0, 0);
    let mut largest = [0.0_f64; 5];
    for seed in 0..200 {
        let mut rng = rng(seed);
        let (width, height) = SIZES[seed as usize % SIZES.len()];
        let view = random_view(&mut rng, width, height);
        let thick = seed % 4 == 0;
        let count = rng.random_range(if thick { 60..120 } else { 1..60 });
        let mut gaussians = random_gaussians(&mut rng, &view, count);
        if thick {
            thicken(&mut gaussians);
        }
        let double = render(&gaussians, &view);
        let single = render(&to_f32(&gaussians), &view);
        for (i, pixel) in reference::render(&gaussians, &view).iter().enumerate() {
            let [r, g, b] = pixel.color;
            let expected = [r, g, b, pixel.depth_m, pixel.alpha];
            let (double, single) = (values(&double, i), values(&single, i));
            for channel in 0..5 {
                let value = expected[channel];
                largest[channel] = largest[channel].max(value);
                if pixel.margin > 1e-9 {
                    let error = (value - double[channel]).abs();
                    assert!(error <= 1e-10, "f64 {seed} {i} {channel}: {error:e}");
                }
                if pixel.margin > 1e-3 {
                    let error = (value - single[channel]).abs() / value.max(1.0);
                    assert!(error <= 2e-5, "f32 {seed} {i} {channel}: {error:e}");
                    compared += 1;
                } else {
                    skipped += 1;
                }
            }
        }
    }
    println!("{compared} compared in f32, {skipped} near thresholds");
    assert!(compared > 100 * skipped);
    assert!(largest.iter().all(|&value| value > 0.9), "{largest:?}");
}

/// Supports that reach over more tiles, along either axis, than are worked on together.
#[test]
fn gaussians_of_many_tiles_agree_with_the_reference() {
    for (seed, (width, height)) in (0..).zip([(330, 21), (21, 330)]) {
        let mut rng = rng(seed);
        let view = random_view(&mut rng, width, height);
        let mut gaussians = random_gaussians(&mut rng, &view, 8);
        for scales in &mut gaussians.log_scales {
            *scales = scales.map(|s| s + 3.5);
        }
        let found = render(&gaussians, &view);
        let mut covered = 0;
        for (i, pixel) in reference::render(&gaussians, &view).iter().enumerate() {
            if pixel.margin > 1e-9 {
                let [.., alpha] = values(&found, i);
                assert!((alpha - pixel.alpha).abs() <= 1e-10, "{i}");
                covered += usize::from(pixel.alpha > 0.1);
            }
        }
        assert!(covered > 4000, "{covered}");
    }
}

/// A camera at the origin whose principal point is the pixel (12, 7), focal lengths 50 and 40.
fn straight_view() -> View {
    let intrinsics = Intrinsics {
        fx: 50.0,
        fy: 40.0,
        cx: 12.0,
        cy: 7.0,
    };
    View {
        camera: Camera::new(30, 20, intrinsics).unwrap(),
        world_from_camera: Se3::identity(),
    }
}

/// A round disk facing the camera on its axis, 2 px wide in x, of that opacity.
fn disk_on_axis(depth: f64, opacity: f64, color: [f64; 3]) -> Gaussians<f64> {
    let scale = 2.0 * depth / 50.0;
    Gaussians {
        means: vec![[0.0, 0.0, depth]],
        quats: vec![[2.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[scale.ln(), scale.ln(), (1e-6_f64).ln()]],
        opacity_logits: vec![(opacity / (1.0 - opacity)).ln()],
        sh: vec![color.map(|c| (c - 0.5) / SH0_FACTOR)],
        inferred: vec![false],
    }
}

fn join(parts: &[&Gaussians<f64>]) -> Gaussians<f64> {
    let mut all = Gaussians::default();
    parts.iter().for_each(|part| all.extend(part));
    all
}

#[test]
fn one_gaussian_follows_the_formula() {
    let rendered = render(&disk_on_axis(2.0, 0.8, [0.9, 0.4, 0.1]), &straight_view());
    let mut outside = 0;
    for v in 0..20 {
        for u in 0..30 {
            // 2 px in x and 40 / 50 of it in y, squared, with 0.3 px^2 of low-pass.
            let (var_x, var_y) = (4.0 + 0.3, 1.6 * 1.6 + 0.3);
            let (dx, dy) = (u as f64 - 12.0, v as f64 - 7.0);
            let mut alpha = 0.8 * (-0.5 * (dx * dx / var_x + dy * dy / var_y)).exp();
            if alpha < 1.0 / 255.0 {
                alpha = 0.0;
                outside += 1;
            }
            let found = values(&rendered, v * 30 + u);
            for (found, factor) in found.iter().zip([0.9, 0.4, 0.1, 2.0, 1.0]) {
                assert!((found - factor * alpha).abs() <= 1e-12, "{u} {v}");
            }
        }
    }
    assert!((300..600).contains(&outside), "{outside}");
}

#[test]
fn faint_samples_are_dropped() {
    let view = straight_view();
    for (alpha, drawn) in [(1.001 / 255.0, true), (0.999 / 255.0, false)] {
        let alpha_found = render(&disk_on_axis(1.0, alpha, [1.0; 3]), &view)
            .alpha
            .at(12, 7);
        assert_eq!(alpha_found > 0.0, drawn);
    }
}

#[test]
fn alpha_is_clamped() {
    let alpha = render(&disk_on_axis(1.0, 0.9999, [1.0; 3]), &straight_view())
        .alpha
        .at(12, 7);
    assert!((alpha - 0.99).abs() <= 1e-15);
}

#[test]
fn a_saturated_pixel_takes_no_more() {
    let (front, back) = (
        disk_on_axis(1.0, 0.98, [0.0; 3]),
        disk_on_axis(2.0, 0.98, [1.0; 3]),
    );
    // Transmittance 0.02^2 = 4e-4 leaves room for the third, 8e-6 after it for no fourth.
    let open = join(&[&back, &front, &front]);
    let shut = join(&[&back, &front, &front, &front]);
    let view = straight_view();
    let red = |gaussians: &Gaussians<f64>| render(gaussians, &view).color.at(12, 7)[0];
    assert!((red(&open) - 0.02_f64.powi(2) * 0.98).abs() <= 1e-15);
    assert_eq!(red(&shut), 0.0);
}

/// The tile's other pixels are open, so the gaussian behind is looked at, but it has no pixel.
#[test]
fn a_gaussian_behind_a_saturated_pixel_is_not_visible() {
    let mut behind = disk_on_axis(2.0, 2.0 / 255.0, [1.0; 3]);
    behind.log_scales[0] = [-15.0; 3];
    let front = disk_on_axis(1.0, 0.98, [0.5; 3]);
    let mut rasterizer = Rasterizer::default();
    let visible = |gaussians: &Gaussians<f64>, rasterizer: &mut Rasterizer<f64>| {
        rasterizer.render(gaussians, &straight_view()).visible()
    };
    let once = join(&[&behind, &front]);
    assert_eq!(visible(&once, &mut rasterizer), [0, 1]);
    let often = join(&[&behind, &front, &front, &front]);
    assert_eq!(visible(&often, &mut rasterizer), [1, 2, 3]);
}

/// Once a tile is saturated, the rest of its list is not even looked at.
#[test]
fn nothing_behind_a_saturated_tile_is_visible() {
    let mut stack = Gaussians::default();
    for i in 0..100 {
        let mut wide = disk_on_axis(1.0 + 0.01 * f64::from(i), 0.999, [0.5; 3]);
        wide.log_scales[0] = [1.0, 1.0, -14.0];
        stack = join(&[&stack, &wide]);
    }
    let mut rasterizer = Rasterizer::default();
    let visible = rasterizer.render(&stack, &straight_view()).visible();
    assert_eq!(visible, [0, 1, 2]);
}

#[test]
fn the_near_plane_cuts() {
    for (depth, drawn) in [(0.2, true), (0.199_999, false), (-1.0, false)] {
        let mut gaussians = disk_on_axis(1.0, 0.9, [1.0; 3]);
        gaussians.means[0][2] = depth;
        let alpha = render(&gaussians, &straight_view()).alpha.at(12, 7);
        assert_eq!(alpha > 0.0, drawn, "{depth}");
    }
}

#[test]
fn color_is_cut_at_zero() {
    let rendered = render(&disk_on_axis(1.0, 0.9, [-0.5, 1.5, 0.0]), &straight_view());
    let [red, green, _] = rendered.color.at(12, 7);
    assert_eq!(red, 0.0);
    assert!((green - 1.5 * 0.9).abs() <= 1e-12);
}

#[test]
fn a_tilted_disk_has_the_depth_of_its_plane() {
    let mut gaussians = disk_on_axis(2.0, 0.9, [1.0; 3]);
    // Turned by 30 degrees about y: the plane z = 2 - tan(30) x (or its mirror image).
    let half = 15_f64.to_radians();
    gaussians.quats[0] = [half.cos(), 0.0, half.sin(), 0.0];
    let rendered = render(&gaussians, &straight_view());
    for u in 8..17 {
        let depth = rendered.depth_m.at(u, 7) / rendered.alpha.at(u, 7);
        // Ray x = (u - 12) / 50 z.
        let slope = (u as f64 - 12.0) / 50.0 * 30_f64.to_radians().tan();
        assert!((depth - 2.0 / (1.0 + slope)).abs() <= 1e-12, "{u}: {depth}");
    }
    // Turned by 86 degrees it is seen edge-on: the centre's depth.
    let half = 43_f64.to_radians();
    gaussians.quats[0] = [half.cos(), 0.0, half.sin(), 0.0];
    let rendered = render(&gaussians, &straight_view());
    let depth = rendered.depth_m.at(13, 7) / rendered.alpha.at(13, 7);
    assert!((depth - 2.0).abs() <= 1e-12);
}

#[test]
fn a_seed_peaks_at_its_pixel_with_its_depth() {
    let mut rng = rng(7);
    for _ in 0..50 {
        let view = random_view(&mut rng, 33, 21);
        let (u, v) = (rng.random_range(0..33), rng.random_range(0..21));
        let depth = rng.random_range(0.5..4.0);
        let mean = view.camera.unproject(u as f64, v as f64, depth);
        let mean = view.world_from_camera.transform(&mean);
        let mut gaussians = disk_on_axis(depth, 0.95, [1.0; 3]);
        gaussians.means[0] = mean.into();
        // Facing along the camera's axis, as seeds without a surface normal do.
        let facing = view.world_from_camera.rotation;
        gaussians.quats[0] = [facing.w, facing.i, facing.j, facing.k];
        let rendered = render(&to_f32(&gaussians), &view);
        let brightest = (0..33 * 21)
            .max_by(|&a, &b| rendered.alpha.data()[a].total_cmp(&rendered.alpha.data()[b]))
            .unwrap();
        assert_eq!((brightest % 33, brightest / 33), (u, v));
        let found = rendered.depth_m.at(u, v) / rendered.alpha.at(u, v);
        assert!(
            (f64::from(found) / depth - 1.0).abs() <= 1e-6,
            "{found} {depth}"
        );
    }
}
