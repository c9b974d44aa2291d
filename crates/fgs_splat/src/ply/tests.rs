//! Round trips, the layout byte by byte, other programs' files, and hostile ones.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn random(len: usize) -> Gaussians {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut gaussians = Gaussians::default();
    for _ in 0..len {
        // Any finite bits: denormals, negative zero and huge values come back too.
        let values = std::array::from_fn(|_| {
            loop {
                let value = f32::from_bits(rng.random());
                if value.is_finite() {
                    break value;
                }
            }
        });
        let inferred = rng.random();
        Vertex { values, inferred }.push_to(&mut gaussians);
    }
    gaussians
}

fn bits(gaussians: &Gaussians) -> Vec<u32> {
    let vertices = (0..gaussians.len()).map(|i| Vertex::of(gaussians, i));
    vertices
        .flat_map(|vertex| {
            let values = vertex.values.map(f32::to_bits);
            values.into_iter().chain([vertex.inferred.into()])
        })
        .collect()
}

fn parse(bytes: &[u8]) -> Result<Gaussians, PlyError> {
    read(Path::new("map.ply"), bytes)
}

/// A text file with one vertex of these properties.
fn text(properties: &[(&str, &str, &str)]) -> String {
    let mut file = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 1\n".to_owned();
    for (kind, name, _) in properties {
        file += &format!("property {kind} {name}\n");
    }
    let values: Vec<&str> = properties.iter().map(|(_, _, value)| *value).collect();
    file + "end_header\n" + &values.join(" ") + "\n"
}

const SHUFFLED: [(&str, &str, &str); 17] = [
    ("float", "rot_3", "0.4"),
    ("double", "z", "3.5"),
    ("float", "y", "-2e-1"),
    ("uchar", "red", "255"),
    ("list uchar int", "ids", "2 7 8"),
    ("float", "x", "1"),
    ("float", "f_dc_2", "0.3"),
    ("float", "f_dc_1", "0.2"),
    ("float", "f_dc_0", "0.1"),
    ("float", "f_rest_0", "9"),
    ("float", "opacity", "-1.5"),
    ("float32", "scale_0", "-4"),
    ("float", "scale_1", "-5"),
    ("float", "scale_2", "-12"),
    ("float", "rot_0", "0.1"),
    ("float", "rot_1", "0.2"),
    ("float", "rot_2", "0.3"),
];

#[test]
fn round_trip_is_bit_exact() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    for gaussians in [random(1000), random(0), random(1)] {
        write_ply(&path, &gaussians).unwrap();
        assert_eq!(bits(&read_ply(&path).unwrap()), bits(&gaussians));
    }
    assert_eq!(folder.path().read_dir().unwrap().count(), 1);
}

#[test]
fn layout_is_the_original_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    let gaussians = Gaussians {
        means: vec![[1.0, 2.0, 3.0]],
        // A quarter turn about x takes the third axis to -y.
        quats: vec![[2.0, 2.0, 0.0, 0.0]],
        log_scales: vec![[-4.0, -5.0, -12.0]],
        opacity_logits: vec![4.5],
        sh: vec![[0.1, 0.2, 0.3]],
        inferred: vec![true],
    };
    write_ply(&path, &gaussians).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\n\
        property float y\nproperty float z\nproperty float nx\nproperty float ny\n\
        property float nz\nproperty float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n\
        property float opacity\nproperty float scale_0\nproperty float scale_1\n\
        property float scale_2\nproperty float rot_0\nproperty float rot_1\n\
        property float rot_2\nproperty float rot_3\nproperty uchar inferred\nend_header\n";
    let values = [
        1.0f32, 2.0, 3.0, 0.0, -1.0, 0.0, 0.1, 0.2, 0.3, 4.5, -4.0, -5.0, -12.0, 2.0, 2.0, 0.0, 0.0,
    ];
    let values = values.map(f32::to_le_bytes);
    let expected = [header.as_bytes(), values.as_flattened(), &[1]];
    assert_eq!(bytes, expected.concat());
}

#[test]
fn other_orders_types_and_encodings() {
    let expected = Gaussians {
        means: vec![[1.0, -0.2, 3.5]],
        quats: vec![[0.1, 0.2, 0.3, 0.4]],
        log_scales: vec![[-4.0, -5.0, -12.0]],
        opacity_logits: vec![-1.5],
        sh: vec![[0.1, 0.2, 0.3]],
        inferred: vec![false],
    };
    assert_eq!(parse(text(&SHUFFLED).as_bytes()).unwrap(), expected);
    // Of another type, `inferred` is not ours.
    for (kind, value, inferred) in [
        ("uchar", "1", true),
        ("uchar", "0", false),
        ("float", "1", false),
    ] {
        let file = text(&[&[(kind, "inferred", value)], &SHUFFLED[..]].concat());
        assert_eq!(parse(file.as_bytes()).unwrap().inferred, [inferred]);
    }
    let big_endian = |(kind, _, value): &(&str, &str, &str)| match *kind {
        "uchar" => vec![255],
        "double" => value.parse::<f64>().unwrap().to_be_bytes().to_vec(),
        "list uchar int" => vec![2, 0, 0, 0, 7, 0, 0, 0, 8],
        _ => value.parse::<f32>().unwrap().to_be_bytes().to_vec(),
    };
    let header = text(&SHUFFLED).replace("ascii", "binary_big_endian");
    let header = header.split_inclusive("end_header\n").next().unwrap();
    let mut file = header.as_bytes().to_vec();
    file.extend(SHUFFLED.iter().flat_map(big_endian));
    assert_eq!(parse(&file).unwrap(), expected);
}

#[test]
fn every_truncation_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    write_ply(&path, &random(3)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for len in 0..bytes.len() {
        assert!(parse(&bytes[..len]).is_err(), "{len}");
    }
    let error = parse(&bytes[..bytes.len() - 1]).unwrap_err();
    assert!(matches!(error, PlyError::Truncated { vertices: 3, .. }));
    assert!(error.to_string().contains("map.ply"), "{error}");
}

#[test]
fn hostile_counts_do_not_allocate() {
    let valid = text(&SHUFFLED);
    for count in [
        "99999999999",
        "18446744073709551615",
        "18446744073709551616",
    ] {
        for encoding in ["ascii", "binary_little_endian"] {
            let file = valid.replace("vertex 1", &format!("vertex {count}"));
            assert!(parse(file.replace("ascii", encoding).as_bytes()).is_err());
        }
    }
    let list = valid.replace("2 7 8", "99999999999 7 8");
    assert!(matches!(
        parse(list.as_bytes()),
        Err(PlyError::Parse { .. })
    ));
    let empty = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nend_header\n";
    assert!(matches!(
        parse(empty.as_bytes()),
        Err(PlyError::Property { property: "x", .. })
    ));
    let other = empty.replace("vertex", "face");
    let error = parse(other.as_bytes()).unwrap_err();
    assert!(matches!(error, PlyError::NoVertices { .. }), "{error}");
    // A header too long to be one, or without even a line.
    let long = "comment x\n".repeat(200_000) + "element vertex 1";
    let long = valid.replace("element vertex 1", &long);
    assert!(matches!(
        parse(long.as_bytes()),
        Err(PlyError::Parse { .. })
    ));
    assert!(parse(&[b'x'; 3 << 20]).is_err());
}

#[test]
fn wrong_properties_are_named() {
    let valid = text(&SHUFFLED);
    for (from, to, named) in [
        ("float opacity", "int opacity", "opacity"),
        ("float rot_2", "list uchar float rot_2", "rot_2"),
        ("scale_1", "scale_9", "scale_1"),
    ] {
        let error = parse(valid.replace(from, to).as_bytes()).unwrap_err();
        let PlyError::Property { property, .. } = error else {
            panic!("{error}")
        };
        assert_eq!(property, named);
    }
}

#[test]
fn values_that_are_not_finite_are_refused() {
    let overflow = text(&SHUFFLED).replace("3.5", "1e300");
    let error = parse(overflow.as_bytes()).unwrap_err();
    assert!(matches!(
        error,
        PlyError::NotFinite {
            vertex: 0,
            property: "z",
            ..
        }
    ));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    let good = random(2);
    write_ply(&path, &good).unwrap();
    let mut bad = good.clone();
    bad.log_scales[1][2] = f32::NAN;
    let error = write_ply(&path, &bad).unwrap_err();
    assert!(
        error.to_string().contains("scale_2 of vertex 1 is NaN"),
        "{error}"
    );
    // The old file is still whole, and nothing else is left.
    assert_eq!(bits(&read_ply(&path).unwrap()), bits(&good));
    assert_eq!(folder.path().read_dir().unwrap().count(), 1);
    let mut bytes = std::fs::read(&path).unwrap();
    let len = bytes.len();
    bytes[len - 5..len - 1].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = parse(&bytes).unwrap_err();
    assert!(matches!(
        error,
        PlyError::NotFinite {
            property: "rot_3",
            ..
        }
    ));
}

#[test]
fn damaged_bytes_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.ply");
    write_ply(&path, &random(2)).unwrap();
    let binary = std::fs::read(&path).unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let mut refused = 0;
    for file in [binary, text(&SHUFFLED).into_bytes()] {
        for _ in 0..3000 {
            let mut damaged = file.clone();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..damaged.len());
                damaged[at] = rng.random();
            }
            refused += usize::from(parse(&damaged).is_err());
        }
    }
    assert!(refused > 1000, "{refused}");
}

#[test]
fn missing_file_and_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("none").join("map.ply");
    assert!(matches!(read_ply(&path), Err(PlyError::Io { .. })));
    let error = write_ply(&path, &random(1)).unwrap_err();
    assert!(matches!(error, PlyError::Io { .. }));
    assert!(error.to_string().contains("map.ply"), "{error}");
}
