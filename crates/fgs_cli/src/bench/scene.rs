//! The scene that mapping is timed on: gaussians at random pixels with depth of one frame, turned at
//! random, with opacity 0.99 and the pixel's colour.
//!
//! Each axis is depth / f times 1 to 2 long if there are 100 000 of them. Of more, each is smaller, so
//! that all together cover as much of the surface: the lengths go with one over the number's root.

use anyhow::ensure;
use fgs_geom::{KeyframeId, RgbdFrame, Se3, View, has_depth};
use fgs_splat::{Gaussian, GaussianModel, Gaussians, Seeds, StepStats, Target};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// So many gaussians have axes of 1 to 2 pixels.
const GAUSSIANS_OF_PIXELS: f64 = 100_000.0;

/// Gaussians in the axes of the frame's camera, the view and what it shows.
pub struct Scene {
    pub gaussians: Gaussians,
    pub view: View,
    pub target: Target,
}

impl Scene {
    /// Of so many gaussians.
    ///
    /// # Errors
    /// If the frame has no depth.
    pub fn new(frame: &RgbdFrame, count: usize) -> anyhow::Result<Self> {
        Ok(Self {
            gaussians: gaussians(frame, count)?,
            view: View {
                camera: frame.camera,
                world_from_camera: Se3::identity(),
            },
            target: Target::from_frame(frame)?,
        })
    }

    /// Puts the gaussians and the view into an empty model.
    ///
    /// # Errors
    /// If the model refuses them.
    pub fn fill(&self, model: &mut impl GaussianModel) -> anyhow::Result<KeyframeId> {
        let id = KeyframeId(0);
        let seeds = Seeds {
            sparse_ids: vec![None; self.gaussians.means.len()],
            gaussians: self.gaussians.clone(),
        };
        model.insert(&seeds, id)?;
        model.add_view(id, self.view, self.target.clone())?;
        Ok(id)
    }
}

/// That each step lowers the loss.
///
/// # Errors
/// If one does not, or there are fewer than two.
pub fn check_fall(steps: &[StepStats]) -> anyhow::Result<()> {
    let losses: Vec<f32> = steps.iter().map(|step| step.loss).collect();
    let falls = losses.len() > 1 && losses.windows(2).all(|pair| pair[1] < pair[0]);
    ensure!(falls, "the loss goes from {losses:?}");
    Ok(())
}

fn gaussians(frame: &RgbdFrame, count: usize) -> anyhow::Result<Gaussians> {
    let camera = &frame.camera;
    let measured: Vec<(usize, usize)> = (0..camera.height)
        .flat_map(|v| (0..camera.width).map(move |u| (u, v)))
        .filter(|&(u, v)| has_depth(frame.depth_m.at(u, v)))
        .collect();
    ensure!(!measured.is_empty(), "the frame has no depth");
    let scale = (GAUSSIANS_OF_PIXELS / count as f64).sqrt();
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut gaussians = Gaussians::default();
    for _ in 0..count {
        let (u, v) = measured[rng.random_range(0..measured.len())];
        let depth_m = f64::from(frame.depth_m.at(u, v));
        let mean = camera.unproject(u as f64, v as f64, depth_m);
        let pixel_m = (scale * depth_m / camera.intrinsics.fx) as f32;
        gaussians.push(&Gaussian {
            mean: [mean.x, mean.y, mean.z].map(|x| x as f32),
            quat: std::array::from_fn(|_| rng.random_range(-1.0..1.0)),
            scales: std::array::from_fn(|_| pixel_m * rng.random_range(1.0..2.0)),
            opacity: 0.99,
            rgb: frame.color.at(u, v).map(|c| f32::from(c) / 255.0),
        });
    }
    Ok(gaussians)
}
