//! The losses against their textbook definitions in f64, and their gradients against dual numbers.

use super::*;
use crate::Gaussians;
use nalgebra::ComplexField;
use num_dual::Dual64;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const WIDTH: usize = 23;
const HEIGHT: usize = 41;

/// A render and its target. A third of the depth is missing; colours reach into the saturated.
struct Scene {
    color: Image<[f32; 3]>,
    depth_m: Image<f32>,
    alpha: Image<f32>,
    target: Target,
}

/// A lens's border: rounded corners and a ragged left edge.
fn border(width: usize, height: usize) -> Arc<Image<bool>> {
    let centered = |x: usize, size: usize| 2.0 * x as f64 / size as f64 - 1.0;
    Arc::new(Image::from_fn(width, height, |u, v| {
        let (x, y) = (centered(u, width), centered(v, height));
        x * x + y * y < 1.5 && u > v % 3
    }))
}

/// The scene, and the scene with pixels that the camera did not see.
fn scenes(width: usize, height: usize, seed: u64) -> [Scene; 2] {
    let [plain, mut bordered] = [scene(width, height, seed), scene(width, height, seed)];
    let valid = border(width, height);
    bordered.target = bordered.target.with_color_valid(valid).unwrap();
    [plain, bordered]
}

fn scene(width: usize, height: usize, seed: u64) -> Scene {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut uniform = |low: f32, high: f32| rng.random_range(low..high);
    let measured = Image::from_fn(width, height, |u, v| {
        let texture = (0.4 * u as f32).sin() * (0.3 * v as f32).cos();
        std::array::from_fn(|c| {
            (255.0 * (0.5 + 0.3 * texture + 0.1 * c as f32 + uniform(-0.1, 0.1))) as u8
        })
    });
    let color = Image::from_fn(width, height, |u, v| {
        measured
            .at(u, v)
            .map(|m| f32::from(m) / 255.0 + uniform(-0.2, 0.3))
    });
    let depth = Image::from_fn(width, height, |_, _| match uniform(0.0, 3.0) {
        missing if missing < 0.5 => 0.0,
        missing if missing < 1.0 => f32::NAN,
        depth => depth,
    });
    Scene {
        color,
        depth_m: Image::from_fn(width, height, |_, _| uniform(0.0, 3.0)),
        alpha: Image::from_fn(width, height, |_, _| uniform(0.0, 1.0)),
        target: Target::new(measured, depth).unwrap(),
    }
}

/// A loss and its derivatives.
#[derive(Debug, PartialEq)]
struct Loss {
    total: f64,
    l1: f64,
    ssim: f64,
    depth: f64,
    d_color: Image<[f32; 3]>,
    d_depth_m: Image<f32>,
    d_alpha: Image<f32>,
}

impl Scene {
    fn try_loss(&self, settings: &LossSettings) -> Result<Loss, LossError> {
        let rendered = Rendered {
            color: self.color.clone(),
            depth_m: self.depth_m.clone(),
            alpha: self.alpha.clone(),
        };
        // Whatever is left over from another loss must not matter.
        let mut cotangents = Cotangents {
            d_color: Image::filled(WIDTH, HEIGHT, [7.0; 3]),
            d_depth_m: Image::filled(WIDTH, HEIGHT, 7.0),
            d_alpha: Image::filled(WIDTH, HEIGHT, 7.0),
        };
        let loss = photometric_loss(&rendered, &self.target, settings, &mut cotangents)?;
        Ok(Loss {
            total: loss.total,
            l1: loss.l1,
            ssim: loss.ssim,
            depth: loss.depth,
            d_color: cotangents.d_color,
            d_depth_m: cotangents.d_depth_m,
            d_alpha: cotangents.d_alpha,
        })
    }

    fn loss(&self, settings: &LossSettings) -> Loss {
        self.try_loss(settings).unwrap()
    }
}

/// SSIM at (u, v) of two images of one channel, by its definition; zeros outside, which is wherever
/// `is_inside` is false.
fn ssim_at(
    x: &Image<Dual64>,
    y: &Image<f64>,
    is_inside: impl Fn(usize, usize) -> bool,
    u: usize,
    v: usize,
) -> Dual64 {
    let weight = |du: i32, dv: i32| (-f64::from(du * du + dv * dv) / (2.0 * 1.5 * 1.5)).exp();
    let offsets = || (-5..=5).flat_map(|dv| (-5..=5).map(move |du| (du, dv)));
    let sum: f64 = offsets().map(|(du, dv)| weight(du, dv)).sum();
    let zero = Dual64::from(0.0);
    let [mut mx, mut my, mut xx, mut yy, mut xy] = [zero; 5];
    for (du, dv) in offsets() {
        let at = (
            u.wrapping_add_signed(du as isize),
            v.wrapping_add_signed(dv as isize),
        );
        let Some(x) = x.get(at.0, at.1).filter(|_| is_inside(at.0, at.1)) else {
            continue;
        };
        let y = y.at(at.0, at.1);
        let w = weight(du, dv) / sum;
        mx += x * w;
        my += Dual64::from(y * w);
        xx += x * x * w;
        yy += Dual64::from(y * y * w);
        xy += x * y * w;
    }
    let (var_x, var_y, cov) = (xx - mx * mx, yy - my * my, xy - mx * my);
    let (c1, c2) = (1e-4, 9e-4);
    (mx * my * 2.0 + c1) * (cov * 2.0 + c2) / ((mx * mx + my * my + c1) * (var_x + var_y + c2))
}

/// Sums of L1 and SSIM over the valid pixels of channel `c`, and their number.
fn reference_color(
    x: &Image<Dual64>,
    target: &Target,
    c: usize,
    masked: bool,
) -> (Dual64, Dual64, f64) {
    let y = target.color.map(|rgb| f64::from(rgb[c]) / 255.0);
    let seen = |u, v| (target.color_valid.as_ref()).is_none_or(|seen| seen.at(u, v));
    let valid = |u, v| seen(u, v) && (!masked || has_depth(target.depth_m.at(u, v)));
    let x = Image::from_fn(x.width(), x.height(), |u, v| match valid(u, v) {
        true => x.at(u, v),
        false => Dual64::from(y.at(u, v)),
    });
    let (mut l1, mut ssim, mut count) = (Dual64::from(0.0), Dual64::from(0.0), 0.0);
    for v in 0..x.height() {
        for u in (0..x.width()).filter(|u| valid(*u, v)) {
            l1 += (x.at(u, v) - y.at(u, v)).abs();
            ssim += ssim_at(&x, &y, seen, u, v);
            count += 1.0;
        }
    }
    (l1, ssim, count)
}

impl Scene {
    fn channel(&self, c: usize) -> Image<Dual64> {
        self.color.map(|rgb| Dual64::from(f64::from(rgb[c])))
    }
}

fn relative_error(actual: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(actual.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    norm(&mut actual.iter().zip(expected).map(|(a, e)| a - e)) / norm(&mut expected.iter().copied())
}

const ONLY_L1: LossSettings = only(1.0, 0.0, 0.0);
const ONLY_SSIM: LossSettings = only(0.0, 1.0, 0.0);
const ONLY_DEPTH: LossSettings = only(0.0, 0.0, 1.0);

const fn only(l1_weight: f32, ssim_weight: f32, depth_weight: f32) -> LossSettings {
    LossSettings {
        l1_weight,
        ssim_weight,
        depth_weight,
        scale_weight: 0.0,
        mask_color_by_depth: false,
        normalize_depth: false,
    }
}

#[test]
fn color_values_match_the_definition() {
    // The last has several strips, the second is smaller than the window.
    let sizes = [(1, 1), (4, 3), (WIDTH, HEIGHT), (17, 70)];
    for scene in sizes
        .map(|(width, height)| scenes(width, height, 1))
        .as_flattened()
    {
        for mask_color_by_depth in [false, true] {
            let settings = LossSettings {
                mask_color_by_depth,
                ..ONLY_SSIM
            };
            let loss = scene.loss(&settings);
            if scene.target.compared_colors(&settings) == 0 {
                assert_eq!((loss.l1, loss.ssim), (0.0, 1.0));
                continue;
            }
            let (mut l1, mut ssim, mut count) = (0.0, 0.0, 0.0);
            for c in 0..3 {
                let x = scene.channel(c);
                let sums = reference_color(&x, &scene.target, c, mask_color_by_depth);
                (l1, ssim, count) = (l1 + sums.0.re, ssim + sums.1.re, count + sums.2);
            }
            let (l1, ssim) = (l1 / count, ssim / count);
            assert!((loss.l1 - l1).abs() <= 1e-6 * l1, "{} {l1}", loss.l1);
            assert!((loss.ssim - ssim).abs() <= 1e-6, "{} {ssim}", loss.ssim);
            assert!((loss.total - (1.0 - loss.ssim)).abs() <= 1e-12);
        }
    }
}

#[test]
fn color_gradients_match_dual_numbers() {
    let [plain, bordered] = scenes(13, 37, 2);
    for (scene, mask_color_by_depth) in [
        (&plain, false),
        (&plain, true),
        (&bordered, false),
        (&bordered, true),
    ] {
        // Of each of the two losses by every colour.
        let expected: (Vec<f64>, Vec<f64>) = (0..3 * scene.color.data().len())
            .into_par_iter()
            .map(|at| {
                let mut x = scene.channel(at % 3);
                x.data_mut()[at / 3].eps = 1.0;
                let (l1, ssim, count) =
                    reference_color(&x, &scene.target, at % 3, mask_color_by_depth);
                (l1.eps / (3.0 * count), -ssim.eps / (3.0 * count))
            })
            .unzip();
        for (settings, expected) in [(ONLY_L1, expected.0), (ONLY_SSIM, expected.1)] {
            let loss = scene.loss(&LossSettings {
                mask_color_by_depth,
                ..settings
            });
            let actual = loss.d_color.data().as_flattened();
            let actual: Vec<f64> = actual.iter().map(|x| f64::from(*x)).collect();
            let error = relative_error(&actual, &expected);
            assert!(error <= 1e-5, "{error}");
        }
    }
}

#[test]
fn equal_images_have_no_loss() {
    let mut scene = scene(WIDTH, HEIGHT, 3);
    scene.color = scene
        .target
        .color
        .map(|rgb| rgb.map(|x| f32::from(x) / 255.0));
    let loss = scene.loss(&only(0.8, 0.2, 0.0));
    assert_eq!((loss.l1, loss.ssim, loss.total), (0.0, 1.0, 0.0));
    assert!(loss.d_color.data().as_flattened().iter().all(|d| *d == 0.0));
}

#[test]
fn what_is_not_valid_has_no_influence() {
    let settings = LossSettings {
        mask_color_by_depth: true,
        ..LossSettings::default()
    };
    let scene = scene(WIDTH, HEIGHT, 4);
    let expected = scene.loss(&settings);
    let mut changed = Scene { ..scene };
    let mut invalid = 0;
    for i in 0..WIDTH * HEIGHT {
        if !has_depth(changed.target.depth_m.data()[i]) {
            changed.color.data_mut()[i] = [7.0, -3.0, 0.1];
            changed.depth_m.data_mut()[i] = 11.0;
            assert_eq!(expected.d_color.data()[i], [0.0; 3]);
            assert_eq!(expected.d_depth_m.data()[i], 0.0);
            invalid += 1;
        }
    }
    assert!(invalid > 100 && invalid < WIDTH * HEIGHT - 100);
    assert_eq!(changed.loss(&settings), expected);
}

#[test]
fn a_mask_of_valid_colors_changes_nothing_else() {
    let settings = LossSettings::default();
    let [mut plain, mut bordered] = scenes(WIDTH, HEIGHT, 4);
    let expected = bordered.loss(&settings);
    let seen = bordered.target.color_valid.clone().unwrap();
    let mut invalid = 0;
    for i in 0..WIDTH * HEIGHT {
        if !seen.data()[i] {
            bordered.color.data_mut()[i] = [7.0, -3.0, 0.1];
            assert_eq!(expected.d_color.data()[i], [0.0; 3]);
            invalid += 1;
        }
    }
    assert!((50..400).contains(&invalid), "{invalid}");
    assert_eq!(bordered.loss(&settings), expected);
    let unmasked = plain.loss(&settings);
    assert_eq!(unmasked.d_depth_m, expected.d_depth_m);
    // A mask that excludes nothing is no mask.
    let all = Arc::new(Image::filled(WIDTH, HEIGHT, true));
    plain.target = plain.target.with_color_valid(all).unwrap();
    assert_eq!(plain.loss(&settings), unmasked);
    let none = Arc::new(Image::filled(WIDTH, HEIGHT, false));
    plain.target = plain.target.with_color_valid(none).unwrap();
    let loss = plain.loss(&only(0.8, 0.2, 0.0));
    assert_eq!((loss.total, loss.l1, loss.ssim), (0.0, 0.0, 1.0));
    assert!(loss.d_color.data().as_flattened().iter().all(|d| *d == 0.0));
    let turned = Arc::new(Image::filled(HEIGHT, WIDTH, true));
    assert!(plain.target.with_color_valid(turned).is_err());
}

#[test]
fn depth_matches_dual_numbers() {
    let scene = scene(WIDTH, HEIGHT, 5);
    for normalize_depth in [false, true] {
        let loss = scene.loss(&LossSettings {
            normalize_depth,
            ..ONLY_DEPTH
        });
        let count = scene.target.measured as f64;
        let (mut value, mut by_depth, mut by_alpha) = (0.0, vec![], vec![]);
        for i in 0..WIDTH * HEIGHT {
            let error = |depth: Dual64, alpha: Dual64| {
                let measured = f64::from(scene.target.depth_m.data()[i]);
                if !has_depth(measured as f32) {
                    return Dual64::from(0.0);
                }
                let divisor = match normalize_depth {
                    false => Dual64::from(1.0),
                    true if alpha.re > f64::from(0.05f32) => alpha,
                    true => Dual64::from(f64::from(0.05f32)),
                };
                (depth / divisor - measured).abs() / (10.0 * count)
            };
            let depth = Dual64::from(f64::from(scene.depth_m.data()[i]));
            let alpha = Dual64::from(f64::from(scene.alpha.data()[i]));
            value += error(depth, alpha).re;
            by_depth.push(error(depth.derivative(), alpha).eps);
            by_alpha.push(error(depth, alpha.derivative()).eps);
        }
        assert!((loss.depth - value).abs() <= 1e-6 * value);
        assert!((loss.total - value).abs() <= 1e-6 * value);
        let wide = |image: &Image<f32>| image.map(|x| f64::from(*x)).into_data();
        assert!(relative_error(&wide(&loss.d_depth_m), &by_depth) <= 1e-6);
        if normalize_depth {
            assert!(relative_error(&wide(&loss.d_alpha), &by_alpha) <= 1e-6);
        } else {
            assert!(loss.d_alpha.data().iter().all(|d| *d == 0.0));
        }
    }
}

#[test]
fn total_is_the_weighted_sum() {
    let scene = scene(WIDTH, HEIGHT, 6);
    let loss = scene.loss(&LossSettings::default());
    let total = 0.8 * loss.l1 + 0.2 * (1.0 - loss.ssim) + 0.1 * loss.depth;
    assert!((loss.total - total).abs() <= 1e-7);
    assert!(0.2 * (1.0 - loss.ssim) > 1e-2 && 0.1 * loss.depth > 1e-3);
    let parts = [ONLY_L1, ONLY_SSIM].map(|settings| scene.loss(&settings).d_color);
    for (i, d) in loss.d_color.data().as_flattened().iter().enumerate() {
        let [l1, ssim] = parts.each_ref().map(|part| part.data().as_flattened()[i]);
        let expected = 0.8 * l1 + 0.2 * ssim;
        assert!((d - expected).abs() <= 1e-6 * (l1.abs() + ssim.abs()));
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scene = scene(31, 150, 7);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap()
            .install(|| scene.loss(&LossSettings::default()))
    };
    assert_eq!(run(1), run(7));
}

#[test]
fn extreme_values_are_refused_or_finite() {
    let mut scene = scene(WIDTH, HEIGHT, 8);
    let settings = LossSettings::default();
    for value in [1e4, -1e4, 1e-40, 0.0] {
        scene.color.data_mut().fill([value, -value, value]);
        scene.depth_m.data_mut().fill(value);
        scene.alpha.data_mut().fill(-value);
        let loss = scene.loss(&settings);
        assert!(loss.total.is_finite());
        let gradients = [loss.d_depth_m.data(), loss.d_alpha.data()].concat();
        assert!(gradients.iter().all(|x| x.is_finite()));
        assert!(
            loss.d_color
                .data()
                .as_flattened()
                .iter()
                .all(|x| x.is_finite())
        );
    }
    for value in [1e38, f32::NAN, f32::NEG_INFINITY] {
        let mut scene = self::scene(WIDTH, HEIGHT, 8);
        scene.color.set(4, 9, [0.5, 0.5, value]);
        let loss = scene.try_loss(&settings);
        let message = loss.unwrap_err().to_string();
        assert!(message.contains("colour at pixel (4, 9)"), "{message}");
    }
}

#[test]
fn nothing_measured_and_wrong_sizes() {
    let mut scene = scene(WIDTH, HEIGHT, 9);
    let color = scene.target.color.clone();
    scene.target = Target::new(color.clone(), Image::filled(WIDTH, HEIGHT, 0.0)).unwrap();
    let masked = LossSettings {
        mask_color_by_depth: true,
        ..LossSettings::default()
    };
    let loss = scene.loss(&masked);
    assert_eq!((loss.total, loss.ssim), (0.0, 1.0));
    assert!(loss.d_color.data().as_flattened().iter().all(|d| *d == 0.0));
    assert!(loss.d_depth_m.data().iter().all(|d| *d == 0.0));
    assert!(Target::new(color, Image::filled(HEIGHT, WIDTH, 0.0)).is_err());
    scene.alpha = Image::filled(WIDTH, HEIGHT - 1, 0.0);
    let loss = scene.try_loss(&LossSettings::default());
    assert!(matches!(loss, Err(LossError::Size { .. })));
}

#[test]
fn scale_regularizer_matches_dual_numbers() {
    let mut rng = Pcg64Mcg::seed_from_u64(10);
    let mut log_scale = |low: f32, high: f32| rng.random_range(low..high);
    let gaussians = Gaussians {
        means: vec![[0.0; 3]; 50],
        log_scales: (0..50)
            .map(|_| {
                [
                    log_scale(-5.0, -2.0),
                    log_scale(-5.0, -2.0),
                    log_scale(-14.0, -10.0),
                ]
            })
            .collect(),
        ..Gaussians::default()
    };
    let in_view = [3, 4, 17, 30, 49];
    let (value, d_log_scales) = scale_regularizer(&gaussians, &in_view);
    let reference = |by: Option<(usize, usize)>| {
        let mut total = Dual64::from(0.0);
        for (entry, index) in in_view.iter().enumerate() {
            let mut logs =
                gaussians.log_scales[*index as usize].map(|x| Dual64::from(f64::from(x)));
            if let Some((by_entry, axis)) = by
                && by_entry == entry
            {
                logs[axis].eps = 1.0;
            }
            let [s1, s2, s3] = logs.map(|x| x.exp());
            let mean = (s1 + s2) / 2.0;
            total += (s1 - mean).abs() + (s2 - mean).abs() + (s3 - 5e-6).abs();
        }
        total / in_view.len() as f64
    };
    assert!((value - reference(None).re).abs() <= 1e-6 * value);
    let expected: Vec<f64> = (0..in_view.len())
        .flat_map(|entry| [0, 1, 2].map(|axis| reference(Some((entry, axis))).eps))
        .collect();
    let actual: Vec<f64> = d_log_scales
        .as_flattened()
        .iter()
        .map(|x| f64::from(*x))
        .collect();
    for axis in 0..3 {
        let pick = |all: &[f64]| {
            all.iter()
                .skip(axis)
                .step_by(3)
                .copied()
                .collect::<Vec<_>>()
        };
        assert!(relative_error(&pick(&actual), &pick(&expected)) <= 1e-6);
    }
    assert_eq!(scale_regularizer(&gaussians, &[]), (0.0, vec![]));
}

#[test]
fn huge_scales_stay_finite() {
    let gaussians = Gaussians {
        log_scales: vec![[3e38, 3e38, 3e38], [-3e38, 200.0, -200.0]],
        ..Gaussians::default()
    };
    let (value, d_log_scales) = scale_regularizer(&gaussians, &[0, 1]);
    assert!(value.is_finite());
    assert!(d_log_scales.as_flattened().iter().all(|d| d.is_finite()));
}
