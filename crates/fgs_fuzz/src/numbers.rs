//! The numerical cores on any numbers, finite or not.

use fgs_geom::{Camera, Image, Intrinsics, KeyframeId, Se3, View};
use fgs_gicp::{Covariance, Point, PointMap, Settings};
use fgs_splat::{CpuModel, GaussianModel, Gaussians, ModelSettings, PruneRule, Seeds, Target};
use nalgebra::{Matrix3, Vector3, Vector6};

/// More are only slower.
const MAX_POINTS: usize = 64;

/// Numbers one after the other, round and round; zeros if there are none.
struct Numbers<'a> {
    bytes: &'a [u8],
    place: usize,
}

impl<'a> Numbers<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, place: 0 }
    }

    fn byte(&mut self) -> u8 {
        let byte = self.bytes.get(self.place).copied().unwrap_or(0);
        self.place = (self.place + 1) % self.bytes.len().max(1);
        byte
    }

    /// Mostly of usual size, now and then any bits.
    fn next(&mut self) -> f32 {
        let kind = self.byte();
        if kind < 16 {
            return f32::from_bits(u32::from_le_bytes([0; 4].map(|_: u8| self.byte())));
        }
        (f32::from(self.byte()) - 127.5) / f32::from(kind)
    }

    fn array<const N: usize>(&mut self) -> [f32; N] {
        std::array::from_fn(|_| self.next())
    }

    fn pose(&mut self) -> Se3 {
        let tangent = Vector6::from(self.array::<6>()).map(f64::from);
        if tangent.iter().all(|x| x.is_finite()) {
            Se3::exp(&tangent)
        } else {
            Se3::new(Default::default(), tangent.fixed_rows::<3>(0).into_owned())
        }
    }
}

/// Registration of any points with any others.
pub fn align(bytes: &[u8]) {
    let mut numbers = Numbers::new(bytes);
    let mut point = || {
        let [xx, xy, xz, yy, yz, zz] = numbers.array().map(f64::from);
        let matrix = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        Point {
            position: Vector3::from(numbers.array::<3>()),
            covariance: Covariance::from_matrix(&matrix),
        }
    };
    let source: Vec<Point> = (0..MAX_POINTS).map(|_| point()).collect();
    let mut target = PointMap::new(0.5);
    for id in 0..MAX_POINTS as u64 {
        target.insert(id, point());
    }
    let settings = Settings {
        max_correspondence_distance_m: 1.0,
        ..Settings::default()
    };
    if let Ok(found) = fgs_gicp::align(&source, &target, &numbers.pose(), &settings) {
        let pose = found.target_from_source;
        assert!(pose.translation.iter().all(|x| x.is_finite()));
        assert!((pose.rotation.norm() - 1.0).abs() <= 1e-6);
    }
}

/// Optimisation steps of any gaussians towards any image.
pub fn model_step(bytes: &[u8]) {
    let mut numbers = Numbers::new(bytes);
    let mut gaussians = Gaussians::default();
    for _ in 0..MAX_POINTS {
        let [x, y, z] = numbers.array();
        gaussians.means.push([x, y, z + 2.0]);
        gaussians.quats.push(numbers.array());
        gaussians
            .log_scales
            .push(numbers.array::<3>().map(|s| s - 2.0));
        gaussians.opacity_logits.push(numbers.next());
        gaussians.sh.push(numbers.array());
        gaussians.inferred.push(false);
    }
    let are_finite = |gaussians: &Gaussians| {
        let vectors = [&gaussians.means, &gaussians.log_scales, &gaussians.sh];
        vectors
            .iter()
            .all(|v| v.as_flattened().iter().all(|x| x.is_finite()))
            && gaussians.quats.as_flattened().iter().all(|x| x.is_finite())
            && gaussians.opacity_logits.iter().all(|x| x.is_finite())
    };
    let was_finite = are_finite(&gaussians);
    let intrinsics = Intrinsics {
        fx: 20.0,
        fy: 20.0,
        cx: 11.5,
        cy: 9.5,
    };
    let view = View {
        camera: Camera::new(24, 20, intrinsics).unwrap(),
        world_from_camera: Se3::identity(),
    };
    let color = Image::from_fn(24, 20, |_, _| std::array::from_fn(|_| numbers.byte()));
    let depth_m = Image::from_fn(24, 20, |_, _| numbers.next());
    let id = KeyframeId(0);
    let mut model = CpuModel::new(ModelSettings::default());
    let seeds = Seeds {
        sparse_ids: vec![None; gaussians.len()],
        gaussians,
    };
    model.insert(&seeds, id).unwrap();
    let Ok(target) = Target::new(color, depth_m) else {
        return;
    };
    model.add_view(id, view, target).unwrap();
    for _ in 0..3 {
        if model.step(id).is_err() {
            return;
        }
    }
    // Moved further than single precision reaches, centres are infinite, and not drawn.
    assert!(
        !was_finite || are_finite(&model.gaussians().unwrap()),
        "not finite"
    );
    let _ = model.match_exposure(id);
    let _ = model.move_anchored(&[(id, numbers.pose())]);
    let rule = PruneRule {
        min_opacity: 0.01,
        max_scale_m: 10.0,
        max_aspect: 100.0,
    };
    model.prune(&rule).unwrap();
    let rendered = model.render(&view).unwrap();
    assert!(
        rendered
            .alpha
            .data()
            .iter()
            .all(|alpha| (0.0..=1.0 + 1e-5).contains(alpha))
    );
}
