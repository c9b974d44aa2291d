//! Gaussians in every format are read back by each format's published layout: all of them, positions to
//! 1e-5 m where the format allows it, colours and opacities to 1/255, shapes as covariances in the axes
//! of the format.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use std::io::Read;

use fgs_export::{write_compressed_ply, write_splat, write_splat_glb, write_splat_ply, write_spz};
use fgs_splat::{Gaussians, SH0_FACTOR, read_ply};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Ply, Property};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;

const COUNT: usize = 1000;

/// Clouds with every parameter different, rotations not normalised, in a room of 10 m.
fn cloud() -> Gaussians {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let mut gaussians = Gaussians::default();
    let mut uniform = |min: f32, max: f32| min + (max - min) * rng.random::<f32>();
    for i in 0..COUNT {
        gaussians.means.push([0; 3].map(|_| uniform(-5.0, 5.0)));
        gaussians.quats.push([0; 4].map(|_| uniform(-2.0, 2.0)));
        gaussians
            .log_scales
            .push([0; 3].map(|_| uniform(-9.0, -1.0)));
        gaussians.opacity_logits.push(uniform(-4.0, 4.0));
        let sh = [0; 3].map(|_| (uniform(0.0, 1.0) - 0.5) / SH0_FACTOR as f32);
        gaussians.sh.push(sh);
        gaussians.inferred.push(i % 7 == 0);
    }
    gaussians
}

/// A gaussian as a reader sees it.
struct Splat {
    mean: [f32; 3],
    quat_wxyz: [f32; 4],
    log_scales: [f32; 3],
    opacity: f32,
    rgb: [f32; 3],
}

/// How far values may be off.
struct Tolerance {
    mean_m: f32,
    /// Of a covariance, relative to its largest variance.
    covariance: f64,
}

const BYTE: f32 = 1.0 / 255.0;

/// The same world turned half a turn about x.
fn y_up() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))
}

fn covariance([w, x, y, z]: [f32; 4], log_scales: [f32; 3]) -> Matrix3<f64> {
    let quat = Quaternion::<f64>::new(w.into(), x.into(), y.into(), z.into());
    let rotation = UnitQuaternion::from_quaternion(quat).to_rotation_matrix();
    let variances = Vector3::from(log_scales.map(|s| (2.0 * f64::from(s)).exp()));
    rotation.matrix() * Matrix3::from_diagonal(&variances) * rotation.matrix().transpose()
}

/// Compares what was read, in the axes `file_from_world`, with gaussian i.
fn assert_same(
    splat: &Splat,
    gaussians: &Gaussians,
    i: usize,
    file_from_world: &Matrix3<f64>,
    tolerance: &Tolerance,
) {
    let mean = file_from_world * Vector3::from(gaussians.means[i]).cast::<f64>();
    let error = (Vector3::from(splat.mean).cast::<f64>() - mean).amax();
    assert!(error <= tolerance.mean_m.into(), "{i}: {error} m");
    let expected = covariance(gaussians.quats[i], gaussians.log_scales[i]);
    let expected = file_from_world * expected * file_from_world.transpose();
    let error = (covariance(splat.quat_wxyz, splat.log_scales) - expected).amax();
    assert!(
        error <= tolerance.covariance * expected.trace(),
        "{i}: {error}"
    );
    let rgb = gaussians.rgb(i);
    for (read, expected) in splat.rgb.into_iter().zip(rgb) {
        assert!((read - expected).abs() <= BYTE, "{i}: {read} {expected}");
    }
    let error = (splat.opacity - gaussians.opacity(i)).abs();
    assert!(error <= BYTE, "{i}: opacity off by {error}");
}

fn float(bytes: &[u8]) -> f32 {
    f32::from_le_bytes(bytes.try_into().unwrap())
}

fn floats<const N: usize>(bytes: &[u8]) -> [f32; N] {
    std::array::from_fn(|i| float(&bytes[4 * i..][..4]))
}

/// What an SPZ file holds, unpacked.
fn unpacked_spz(gaussians: &Gaussians) -> Vec<u8> {
    let (mut file, mut bytes) = (Vec::new(), Vec::new());
    write_spz(&mut file, gaussians).unwrap();
    let mut unpacked = flate2::read::GzDecoder::new(file.as_slice());
    unpacked.read_to_end(&mut bytes).unwrap();
    bytes
}

fn parsed(mut bytes: &[u8]) -> Ply<DefaultElement> {
    let parser = Parser::<DefaultElement>::new();
    parser.read_ply(&mut bytes).unwrap()
}

#[test]
fn standard_ply_holds_the_stored_values_and_nothing_else() {
    let gaussians = cloud();
    let mut bytes = Vec::new();
    write_splat_ply(&mut bytes, &gaussians).unwrap();
    let ply = parsed(&bytes);
    let names: Vec<&str> = ply.header.elements["vertex"]
        .properties
        .keys()
        .map(|k| &**k)
        .collect();
    assert_eq!(
        names.join(" "),
        "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    );
    assert_eq!(ply.payload["vertex"].len(), COUNT);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    std::fs::write(&path, &bytes).unwrap();
    let read = read_ply(&path).unwrap();
    let expected = Gaussians {
        inferred: vec![false; COUNT],
        ..gaussians
    };
    assert!(read == expected);
}

#[test]
fn splat() {
    let gaussians = cloud();
    let mut bytes = Vec::new();
    write_splat(&mut bytes, &gaussians).unwrap();
    assert_eq!(bytes.len(), 32 * COUNT);
    let mut found = vec![false; COUNT];
    let mut last = f32::INFINITY;
    for row in bytes.chunks(32) {
        let mean = floats(row);
        let scales: [f32; 3] = floats(&row[12..]);
        let i = gaussians.means.iter().position(|m| *m == mean).unwrap();
        assert!(!std::mem::replace(&mut found[i], true), "{i} twice");
        let splat = Splat {
            mean,
            log_scales: scales.map(f32::ln),
            rgb: [24, 25, 26].map(|at| f32::from(row[at]) / 255.0),
            opacity: f32::from(row[27]) / 255.0,
            quat_wxyz: [28, 29, 30, 31].map(|at| (f32::from(row[at]) - 128.0) / 128.0),
        };
        let tolerance = Tolerance {
            mean_m: 0.0,
            covariance: 0.02,
        };
        assert_same(&splat, &gaussians, i, &Matrix3::identity(), &tolerance);
        let visibility = scales.iter().product::<f32>() * gaussians.opacity(i);
        assert!(visibility <= last * 1.0001, "the most visible come first");
        last = visibility;
    }
}

/// By the description in Niantic's README and its reader's constants.
#[test]
fn spz() {
    let gaussians = cloud();
    let bytes = unpacked_spz(&gaussians);
    let word = |at: usize| u32::from_le_bytes(bytes[at..][..4].try_into().unwrap());
    assert_eq!([word(0), word(4), word(8)], [0x5053_474e, 3, COUNT as u32]);
    let [degree, fractional_bits, flags, reserved] = bytes[12..16].try_into().unwrap();
    assert_eq!([degree, flags, reserved], [0; 3]);
    assert_eq!(bytes.len(), 16 + (9 + 1 + 3 + 3 + 4) * COUNT);
    let [alphas, colors, scales, rotations] = [9, 10, 13, 16].map(|before| 16 + before * COUNT);
    for i in 0..COUNT {
        let mean = [0, 1, 2].map(|axis| {
            let at = 16 + 9 * i + 3 * axis;
            let steps = i32::from_le_bytes([0, bytes[at], bytes[at + 1], bytes[at + 2]]) >> 8;
            steps as f32 / f32::from(2_u8).powi(fractional_bits.into())
        });
        let byte = |at: usize| f32::from(bytes[at]);
        let packed = word(rotations + 4 * i);
        let largest = (packed >> 30) as usize;
        let mut xyzw = [0.0; 4];
        let others = (0..4).filter(|i| *i != largest);
        for (other, shift) in others.zip([20, 10, 0]) {
            let bits = packed >> shift & 0x3ff;
            let magnitude = (bits & 0x1ff) as f32 / 511.0 / 2_f32.sqrt();
            xyzw[other] = if bits & 0x200 == 0 {
                magnitude
            } else {
                -magnitude
            };
        }
        xyzw[largest] = (1.0 - xyzw.iter().map(|q| q * q).sum::<f32>()).sqrt();
        let [x, y, z, w] = xyzw;
        let splat = Splat {
            mean,
            quat_wxyz: [w, x, y, z],
            log_scales: [0, 1, 2].map(|axis| byte(scales + 3 * i + axis) / 16.0 - 10.0),
            opacity: byte(alphas + i) / 255.0,
            rgb: [0, 1, 2].map(|axis| {
                let sh = (byte(colors + 3 * i + axis) / 255.0 - 0.5) / 0.15;
                0.5 + SH0_FACTOR as f32 * sh
            }),
        };
        let tolerance = Tolerance {
            mean_m: 1e-5,
            covariance: 0.07,
        };
        assert_same(&splat, &gaussians, i, &y_up(), &tolerance);
    }
}

/// Far from the origin the steps are larger, but nothing wraps around.
#[test]
fn spz_of_a_large_world() {
    let mut gaussians = cloud();
    gaussians.means[0] = [1000.0, -3000.0, 0.0];
    let bytes = unpacked_spz(&gaussians);
    let coordinate = |axis: usize| {
        let [a, b, c] = bytes[16 + 3 * axis..][..3].try_into().unwrap();
        let steps = i32::from_le_bytes([0, a, b, c]) >> 8;
        steps as f32 / 2_f32.powi(bytes[13].into())
    };
    assert_eq!([0, 1, 2].map(coordinate), [1000.0, 3000.0, 0.0]);
}

/// By the decoding in PlayCanvas's splat-transform.
#[test]
fn compressed_ply() {
    let gaussians = cloud();
    let mut bytes = Vec::new();
    write_compressed_ply(&mut bytes, &gaussians).unwrap();
    let ply = parsed(&bytes);
    let (chunks, vertices) = (&ply.payload["chunk"], &ply.payload["vertex"]);
    assert_eq!((chunks.len(), vertices.len()), (COUNT.div_ceil(256), COUNT));
    let mut found = vec![false; COUNT];
    for (row, vertex) in vertices.iter().enumerate() {
        let chunk = &chunks[row / 256];
        let bound = |name: String| match chunk[&*name] {
            Property::Float(value) => value,
            ref other => panic!("{name} is {other:?}"),
        };
        let word = |name: &str| match vertex[name] {
            Property::UInt(value) => value,
            ref other => panic!("{name} is {other:?}"),
        };
        let unit = |value: u32, shift: u32, bits: u32| {
            let max = (1_u32 << bits) - 1;
            (value >> shift & max) as f32 / max as f32
        };
        let between = |names: [&str; 3], t: [f32; 3]| {
            [0, 1, 2].map(|axis| {
                let name = names[axis];
                let (min, max) = (bound(format!("min_{name}")), bound(format!("max_{name}")));
                min * (1.0 - t[axis]) + max * t[axis]
            })
        };
        let coarse = |value: u32| [unit(value, 21, 11), unit(value, 11, 10), unit(value, 0, 11)];
        let mean = between(["x", "y", "z"], coarse(word("packed_position")));
        let log_scales = between(
            ["scale_x", "scale_y", "scale_z"],
            coarse(word("packed_scale")),
        );
        let color = word("packed_color");
        let rgb = between(
            ["r", "g", "b"],
            [24, 16, 8].map(|shift| unit(color, shift, 8)),
        );
        let rotation = word("packed_rotation");
        let largest = (rotation >> 30) as usize;
        let mut quat_wxyz = [0.0; 4];
        let others = (0..4).filter(|i| *i != largest);
        for (other, shift) in others.zip([20, 10, 0]) {
            quat_wxyz[other] = (unit(rotation, shift, 10) - 0.5) * 2_f32.sqrt();
        }
        quat_wxyz[largest] = (1.0 - quat_wxyz.iter().map(|q| q * q).sum::<f32>()).sqrt();

        let distance = |i: usize| (Vector3::from(gaussians.means[i]) - Vector3::from(mean)).norm();
        let i = (0..COUNT)
            .min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
            .unwrap();
        assert!(!std::mem::replace(&mut found[i], true), "{i} twice");
        let splat = Splat {
            mean,
            quat_wxyz,
            log_scales,
            opacity: unit(color, 0, 8),
            rgb,
        };
        let extent =
            ["x", "y", "z"].map(|axis| bound(format!("max_{axis}")) - bound(format!("min_{axis}")));
        let tolerance = Tolerance {
            // Half a step of 10 bits; on y, the coarsest.
            mean_m: extent.into_iter().fold(0.0, f32::max) * 0.501 / 1023.0,
            covariance: 0.02,
        };
        assert_same(&splat, &gaussians, i, &Matrix3::identity(), &tolerance);
    }
}

/// JSON and binary chunk of a GLB file.
fn glb_chunks(bytes: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..][..4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!([word(4), word(8)], [2, bytes.len()]);
    let json_len = word(12);
    assert_eq!(&bytes[16..20], b"JSON");
    let json = serde_json::from_slice(&bytes[20..][..json_len]).unwrap();
    let binary = 20 + json_len;
    assert_eq!(&bytes[binary + 4..][..4], b"BIN\0");
    let buffer = &bytes[binary + 8..];
    assert_eq!(buffer.len(), word(binary));
    (json, buffer)
}

#[test]
fn glb() {
    let gaussians = cloud();
    let mut bytes = Vec::new();
    write_splat_glb(&mut bytes, &gaussians).unwrap();
    let (json, buffer) = glb_chunks(&bytes);
    let primitive = &json["meshes"][0]["primitives"][0];
    assert_eq!(primitive["mode"], 0);
    let extension = &primitive["extensions"]["KHR_gaussian_splatting"];
    assert_eq!(extension["kernel"], "ellipse");
    assert_eq!(extension["colorSpace"], "srgb_rec709_display");
    assert_eq!(json["extensionsUsed"][0], "KHR_gaussian_splatting");

    let accessor = |name: &str| {
        let accessor = primitive["attributes"][name].as_u64().unwrap() as usize;
        &json["accessors"][accessor]
    };
    let rows = |name: &str, kind: &str, size: usize| {
        let accessor = accessor(name);
        assert_eq!(accessor["type"], kind, "{name}");
        assert_eq!(accessor["count"], COUNT, "{name}");
        let view = accessor["bufferView"].as_u64().unwrap() as usize;
        let view = &json["bufferViews"][view];
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!(start % 4, 0);
        assert_eq!(view["byteLength"], size * COUNT);
        buffer[start..][..size * COUNT].chunks(size)
    };
    let splatting = |name: &str| format!("KHR_gaussian_splatting:{name}");
    let means = rows("POSITION", "VEC3", 12);
    let rotations = rows(&splatting("ROTATION"), "VEC4", 16);
    let scales = rows(&splatting("SCALE"), "VEC3", 12);
    let opacities = rows(&splatting("OPACITY"), "SCALAR", 4);
    let colors = rows(&splatting("SH_DEGREE_0_COEF_0"), "VEC3", 12);
    let (mut min, mut max) = ([f32::INFINITY; 3], [-f32::INFINITY; 3]);
    let rows = means.zip(rotations).zip(scales).zip(opacities).zip(colors);
    for (i, ((((mean, rotation), scales), opacity), sh)) in rows.enumerate() {
        let mean: [f32; 3] = floats(mean);
        for axis in 0..3 {
            min[axis] = min[axis].min(mean[axis]);
            max[axis] = max[axis].max(mean[axis]);
        }
        let [x, y, z, w] = floats(rotation);
        let length = [x, y, z, w].iter().map(|q| q * q).sum::<f32>();
        assert!((length - 1.0).abs() <= 1e-5);
        let splat = Splat {
            mean,
            quat_wxyz: [w, x, y, z],
            log_scales: floats(scales).map(f32::ln),
            opacity: float(opacity),
            rgb: floats(sh).map(|sh| 0.5 + SH0_FACTOR as f32 * sh),
        };
        let tolerance = Tolerance {
            mean_m: 0.0,
            covariance: 1e-5,
        };
        assert_same(&splat, &gaussians, i, &y_up(), &tolerance);
    }
    let bound = |name: &str| -> Vec<f64> {
        serde_json::from_value(accessor("POSITION")[name].clone()).unwrap()
    };
    assert_eq!(bound("min"), min.map(f64::from));
    assert_eq!(bound("max"), max.map(f64::from));
}

/// Values that only a damaged map has become neither NaN nor infinite, and nothing panics.
#[test]
fn extreme_values() {
    let mut gaussians = cloud();
    for (i, value) in [0.0, f32::MAX, -f32::MAX, f32::MIN_POSITIVE]
        .into_iter()
        .enumerate()
    {
        gaussians.quats[i] = [value; 4];
        gaussians.log_scales[i] = [value; 3];
        gaussians.opacity_logits[i] = value;
        gaussians.sh[i] = [value; 3];
        gaussians.means[i + 4] = [value; 3];
    }
    let mut out = Vec::new();
    write_splat_ply(&mut out, &gaussians).unwrap();
    write_splat(&mut out, &gaussians).unwrap();
    write_spz(&mut out, &gaussians).unwrap();
    write_compressed_ply(&mut out, &gaussians).unwrap();
    let mut glb = Vec::new();
    write_splat_glb(&mut glb, &gaussians).unwrap();
    let (json, buffer) = glb_chunks(&glb);
    assert_eq!(json["meshes"][0]["primitives"][0]["mode"], 0);
    assert!(buffer.chunks(4).all(|bytes| float(bytes).is_finite()));
}
