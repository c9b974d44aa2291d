//! Scenes for the tests of the stages, and a model that holds one.

use fgs_geom::{Image, KeyframeId, View};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::device::device;
use crate::cpu::tests::scenes::{random_gaussians, random_view, rng, thicken, to_f32};
use crate::gpu::gpu_model::GpuModel;
use crate::{Gaussian, GaussianModel, Gaussians, ModelSettings, Seeds, SparseId, Target};

pub struct Scene {
    pub name: &'static str,
    pub view: View,
    pub gaussians: Gaussians,
}

/// Images of many sizes, gaussians of many kinds.
pub fn scenes() -> Vec<Scene> {
    let mut rng = rng(40);
    let mut scenes = Vec::new();
    for (name, width, height, count) in [
        ("one pixel", 1, 1, 30),
        ("17x33", 17, 33, 120),
        ("no gaussians", 20, 12, 0),
        ("many tiles", 120, 90, 3000),
        ("a single row", 200, 1, 50),
    ] {
        let view = random_view(&mut rng, width, height);
        let gaussians = to_f32(&random_gaussians(&mut rng, &view, count));
        scenes.push(Scene {
            name,
            view,
            gaussians,
        });
    }
    let view = random_view(&mut rng, 70, 50);
    let mut gaussians = random_gaussians(&mut rng, &view, 400);
    thicken(&mut gaussians);
    scenes.push(Scene {
        name: "saturated",
        view,
        gaussians: to_f32(&gaussians),
    });
    let view = random_view(&mut rng, 90, 70);
    let mut gaussians = Gaussians::default();
    let centre = view.camera.unproject(40.0, 30.0, 2.0);
    gaussians.push(&Gaussian {
        mean: view.world_from_camera.transform(&centre).into(),
        quat: [0.9, 0.1, -0.3, 0.2],
        scales: [5.0, 4.0, 3.0],
        opacity: 0.9,
        rgb: [0.2, 0.7, 0.4],
    });
    scenes.push(Scene {
        name: "one covers everything",
        view,
        gaussians: to_f32(&gaussians),
    });
    let view = random_view(&mut rng, 40, 30);
    let mut gaussians = random_gaussians(&mut rng, &view, 200);
    for mean in &mut gaussians.means {
        let behind = view.camera.unproject(20.0, 15.0, -1.0);
        *mean = view.world_from_camera.transform(&behind).into();
    }
    scenes.push(Scene {
        name: "all culled",
        view,
        gaussians: to_f32(&gaussians),
    });
    let view = random_view(&mut rng, 60, 40);
    let mut gaussians = to_f32(&random_gaussians(&mut rng, &view, 300));
    poison(&mut gaussians, &mut rng);
    scenes.push(Scene {
        name: "poisoned",
        view,
        gaussians,
    });
    scenes
}

/// Damages every fourth gaussian.
fn poison(gaussians: &mut Gaussians, rng: &mut Pcg64Mcg) {
    let poisons = [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e38, 1e-40];
    for i in (0..gaussians.len()).step_by(4) {
        let value = poisons[rng.random_range(0..poisons.len())];
        match rng.random_range(0..6) {
            0 => gaussians.means[i][rng.random_range(0..3)] = value,
            1 => gaussians.quats[i][rng.random_range(0..4)] = value,
            2 => gaussians.log_scales[i][rng.random_range(0..3)] = value,
            3 => gaussians.opacity_logits[i] = value,
            4 => gaussians.sh[i][rng.random_range(0..3)] = value,
            _ => gaussians.quats[i] = [0.0; 4],
        }
    }
}

/// Seeds of which every third is part of the sparse map.
pub fn seeds(gaussians: &Gaussians) -> Seeds {
    let ids = 0..gaussians.len() as u32;
    Seeds {
        gaussians: gaussians.clone(),
        sparse_ids: ids.map(|i| (i % 3 == 0).then_some(SparseId(i))).collect(),
    }
}

/// Random colours and depths; every fifth pixel has no valid depth.
pub fn random_target(rng: &mut Pcg64Mcg, view: &View) -> Target {
    let (width, height) = (view.camera.width, view.camera.height);
    let color = Image::from_fn(width, height, |_, _| {
        std::array::from_fn(|_| rng.random_range(0..=255_u8))
    });
    let depth = Image::from_fn(width, height, |u, v| match (u + v) % 5 {
        0 => [0.0, f32::NAN, -1.0, f32::INFINITY][u % 4],
        _ => rng.random_range(0.5..4.0),
    });
    Target::new(color, depth).unwrap()
}

/// A model that holds the scene's gaussians; `None` if there is no device.
pub fn model_of(scene: &Scene, settings: &ModelSettings) -> Option<GpuModel> {
    let mut model = GpuModel::new(device()?, settings).unwrap();
    model
        .insert(&seeds(&scene.gaussians), KeyframeId(0))
        .unwrap();
    Some(model)
}
