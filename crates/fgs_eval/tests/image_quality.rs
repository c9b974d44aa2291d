//! PSNR and SSIM against scikit-image (`golden/make_images.py`), and special images.

#![allow(clippy::unwrap_used)]

use fgs_eval::{EvalError, ImageQuality, MAX_PSNR_DB, image_quality, ssim};
use fgs_geom::Image;

type Images = (Image<[f32; 3]>, Image<[u8; 3]>, Image<f32>);

/// The images of `golden/make_images.py`: render, target, measured depth.
fn images(width: usize, height: usize) -> Images {
    let target = Image::from_fn(width, height, |u, v| {
        let checks = (u / 4 + v / 3) % 2 * 90;
        [0, 1, 2].map(|c| ((3 * u + 2 * v + 40 * c + checks) % 256) as u8)
    });
    let render = Image::from_fn(width, height, |u, v| {
        std::array::from_fn(|c| {
            let noise = (7 * u * u + 13 * v + 5 * c * u + u * v) % 41;
            (f64::from(target.at(u, v)[c]) / 255.0 + (noise as f64 / 100.0 - 0.2)) as f32
        })
    });
    let depth_m = Image::from_fn(
        width,
        height,
        |u, v| {
            if (u + 2 * v) % 7 > 1 { 2.0 } else { 0.0 }
        },
    );
    (render, target, depth_m)
}

/// The render that shows exactly the target.
fn perfect(target: &Image<[u8; 3]>) -> Image<[f32; 3]> {
    target.map(|pixel| pixel.map(|value| f32::from(value) / 255.0))
}

#[test]
fn equals_scikit_image() {
    let expected = [
        (
            (48, 37),
            19.0334304981073,
            19.0488251146558,
            20.5086385081346,
            0.878829973336865,
        ),
        (
            (11, 11),
            18.5646730641603,
            18.328113949828,
            19.8109831405569,
            0.826820327670274,
        ),
        (
            (23, 64),
            18.9396678607505,
            18.9235444675829,
            20.3907295768983,
            0.866668057259276,
        ),
    ];
    for ((width, height), all, valid_depth, paper, ssim) in expected {
        let (render, target, depth_m) = images(width, height);
        let quality = image_quality(&render, &target, &depth_m, None).unwrap();
        for (actual, expected) in [
            (quality.psnr_db, all),
            (quality.psnr_valid_depth_db.unwrap(), valid_depth),
            (quality.psnr_paper_db, paper),
            (quality.ssim, ssim),
        ] {
            let error = (actual - expected).abs();
            assert!(error <= 1e-9, "{width}x{height}: {actual} for {expected}");
        }
    }
}

#[test]
fn identical_images_reach_the_cap() {
    let (_, target, depth_m) = images(30, 20);
    let quality = image_quality(&perfect(&target), &target, &depth_m, None).unwrap();
    assert_eq!(quality.psnr_db, MAX_PSNR_DB);
    assert_eq!(quality.psnr_valid_depth_db, Some(MAX_PSNR_DB));
    assert_eq!(quality.psnr_paper_db, MAX_PSNR_DB);
    assert!((quality.ssim - 1.0).abs() <= 1e-6);
}

#[test]
fn without_depth_only_the_papers_psnr_flatters() {
    let (render, target, _) = images(30, 20);
    let none = Image::filled(30, 20, f32::NAN);
    let quality = image_quality(&render, &target, &none, None).unwrap();
    assert_eq!(quality.psnr_valid_depth_db, None);
    assert_eq!(quality.psnr_paper_db, MAX_PSNR_DB);
    assert!(quality.psnr_db < 25.0);
}

#[test]
fn flat_images() {
    let black = Image::filled(16, 12, [0_u8; 3]);
    let white = Image::filled(16, 12, [f32::INFINITY; 3]);
    let depth_m = Image::filled(16, 12, 1.0);
    let quality = image_quality(&white, &black, &depth_m, None).unwrap();
    assert_eq!(quality.psnr_db, 0.0);
    assert!(quality.ssim > 0.0 && quality.ssim <= 1e-4);
    let same = ssim(&Image::filled(16, 12, [0.0; 3]), &black, None).unwrap();
    assert_eq!(same, 1.0);
}

#[test]
fn unusable_images_are_named() {
    let (mut render, target, depth_m) = images(20, 15);
    let (other, _, other_depth_m) = images(15, 20);
    let unequal = EvalError::UnequalSizes {
        a: (15, 20),
        b: (20, 15),
    };
    assert_eq!(ssim(&other, &target, None), Err(unequal));
    assert!(image_quality(&render, &target, &other_depth_m, None).is_err());
    let (small, small_target, _) = images(20, 10);
    assert!(matches!(
        ssim(&small, &small_target, None),
        Err(EvalError::TooSmall { minimum: 11, .. })
    ));
    render.set(7, 3, [0.5, f32::NAN, 0.5]);
    let nan = Err(EvalError::NotANumber { u: 7, v: 3 });
    assert_eq!(image_quality(&render, &target, &depth_m, None), nan);
}

#[test]
fn a_change_of_exposure_costs_nothing_with_exposure() {
    let (_, target, depth_m) = images(48, 37);
    let render = target.map(|rgb| {
        let [r, g, b] = rgb.map(|c| f32::from(c) / 255.0);
        [0.8 * r + 0.05, 0.7 * g + 0.1, 0.9 * b]
    });
    let quality = image_quality(&render, &target, &depth_m, None).unwrap();
    assert!(quality.psnr_db <= 25.0, "{quality:?}");
    assert!(quality.psnr_exposure_db >= 99.0, "{quality:?}");
    assert!(quality.psnr_exposure_valid_depth_db.unwrap() >= 99.0);
}

#[test]
fn mean_over_frames() {
    let frame = |psnr_valid_depth_db, value: f64| ImageQuality {
        psnr_valid_depth_db,
        psnr_db: value,
        psnr_paper_db: value + 1.0,
        psnr_exposure_valid_depth_db: psnr_valid_depth_db.map(|db: f64| db + 2.0),
        psnr_exposure_db: value + 2.0,
        ssim: value / 64.0,
    };
    let mean = ImageQuality::mean(&[frame(Some(30.0), 20.0), frame(None, 40.0)]);
    assert_eq!(mean, Some(frame(Some(30.0), 30.0)));
    assert_eq!(ImageQuality::mean(&[]), None);
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let (render, target, depth_m) = images(200, 150);
    let with_threads = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        pool.install(|| image_quality(&render, &target, &depth_m, None).unwrap())
    };
    let (one, many) = (with_threads(1), with_threads(16));
    assert_eq!(one.ssim.to_bits(), many.ssim.to_bits());
    assert_eq!(one, many);
}

/// An oval view with an unseen spot in it.
fn oval(width: usize, height: usize) -> Image<bool> {
    let centered = |x: usize, size: usize| 2.0 * x as f64 / size as f64 - 1.0;
    Image::from_fn(width, height, |u, v| {
        centered(u, width).powi(2) + centered(v, height).powi(2) < 1.1 && (u, v) != (14, 21)
    })
}

/// SSIM of one channel of the window around (u, v), straight from its definition.
fn reference_ssim(x: &Image<f64>, y: &Image<f64>, u: usize, v: usize) -> f64 {
    let offsets = || (0..11).flat_map(|dv| (0..11).map(move |du| (du, dv)));
    let weight = |du: usize, dv: usize| {
        let r2 = (du as f64 - 5.0).powi(2) + (dv as f64 - 5.0).powi(2);
        (-r2 / (2.0 * 1.5 * 1.5)).exp()
    };
    let total: f64 = offsets().map(|(du, dv)| weight(du, dv)).sum();
    let mean = |value: &dyn Fn(f64, f64) -> f64| {
        let terms = offsets().map(|(du, dv)| {
            let (u, v) = (u + du - 5, v + dv - 5);
            weight(du, dv) * value(x.at(u, v), y.at(u, v))
        });
        terms.sum::<f64>() / total
    };
    let (mx, my) = (mean(&|x, _| x), mean(&|_, y| y));
    let var_x = mean(&|x, _| (x - mx).powi(2));
    let var_y = mean(&|_, y| (y - my).powi(2));
    let covariance = mean(&|x, y| (x - mx) * (y - my));
    (2.0 * mx * my + 1e-4) * (2.0 * covariance + 9e-4)
        / ((mx * mx + my * my + 1e-4) * (var_x + var_y + 9e-4))
}

#[test]
fn unseen_pixels_are_outside_the_image() {
    let (width, height) = (48, 37);
    let (mut render, mut target, depth_m) = images(width, height);
    let seen = oval(width, height);
    let quality = image_quality(&render, &target, &depth_m, Some(&seen)).unwrap();

    let channel = |c: usize| {
        let x = render.map(|rgb| f64::from(rgb[c]).clamp(0.0, 1.0));
        (x, target.map(|rgb| f64::from(rgb[c]) / 255.0))
    };
    let (mut all, mut with_depth, mut pixels, mut pixels_with_depth) = (0.0, 0.0, 0.0, 0.0);
    let (mut ssim, mut windows) = (0.0, 0.0);
    for (x, y) in [0, 1, 2].map(channel) {
        for v in 0..height {
            for u in (0..width).filter(|u| seen.at(*u, v)) {
                let error = (x.at(u, v) - y.at(u, v)).powi(2);
                (all, pixels) = (all + error, pixels + 1.0);
                if depth_m.at(u, v) > 0.0 {
                    (with_depth, pixels_with_depth) = (with_depth + error, pixels_with_depth + 1.0);
                }
                let is_seen = |du: usize, dv: usize| {
                    let (u, v) = ((u + du).wrapping_sub(5), (v + dv).wrapping_sub(5));
                    seen.get(u, v) == Some(true)
                };
                if (0..11).all(|dv| (0..11).all(|du| is_seen(du, dv))) {
                    ssim += reference_ssim(&x, &y, u, v);
                    windows += 1.0;
                }
            }
        }
    }
    assert!(windows > 100.0 && windows < 3.0 * 38.0 * 27.0 - 100.0);
    let psnr = |sum: f64, count: f64| -10.0 * (sum / count).log10();
    for (actual, expected) in [
        (quality.psnr_db, psnr(all, pixels)),
        (
            quality.psnr_valid_depth_db.unwrap(),
            psnr(with_depth, pixels_with_depth),
        ),
        (quality.psnr_paper_db, psnr(with_depth, pixels)),
        (quality.ssim, ssim / windows),
    ] {
        assert!((actual - expected).abs() <= 1e-9, "{actual} for {expected}");
    }

    // What they hold does not matter.
    for (i, seen) in seen.data().iter().enumerate() {
        if !seen {
            (render.data_mut()[i], target.data_mut()[i]) = ([1.0; 3], [0; 3]);
        }
    }
    let changed = image_quality(&render, &target, &depth_m, Some(&seen));
    assert_eq!(changed, Ok(quality));
}

#[test]
fn masks_that_exclude_nothing_or_too_much() {
    let (render, target, depth_m) = images(30, 20);
    let plain = image_quality(&render, &target, &depth_m, None);
    let all = Image::filled(30, 20, true);
    assert_eq!(image_quality(&render, &target, &depth_m, Some(&all)), plain);
    let sparse = Image::from_fn(30, 20, |u, v| u % 11 > 0 && v > 0);
    let refused = image_quality(&render, &target, &depth_m, Some(&sparse));
    assert_eq!(refused, Err(EvalError::NoCompleteWindow { side: 11 }));
    let turned = Image::filled(20, 30, true);
    assert!(image_quality(&render, &target, &depth_m, Some(&turned)).is_err());
}
