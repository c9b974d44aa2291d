//! `--camera-source KIND:NAME`: opens a live camera of one of the kinds that this program was built with.

use fgs_data::CameraSource;
use fgs_run::RunObserver;

use crate::console::Console;
use crate::failure::UsageError;

/// An open camera.
pub struct OpenCamera {
    /// Its images.
    pub source: Box<dyn CameraSource>,
    /// What hands poses and map on to the camera's system, if that takes them.
    pub publisher: Option<Box<dyn RunObserver>>,
}

/// Opens the camera of a name and waits until it is there.
type Open = fn(&str) -> anyhow::Result<OpenCamera>;

/// Kinds, which are the features that they are built with.
const KINDS: [&str; 3] = ["orbbec", "realsense", "ros2"];

/// Those that are built in.
const BUILT: &[(&str, Open)] = &[
    #[cfg(feature = "orbbec")]
    ("orbbec", orbbec),
    #[cfg(feature = "realsense")]
    ("realsense", realsense),
    #[cfg(feature = "ros2")]
    ("ros2", ros2),
];

/// Opens a camera and waits until it is there.
///
/// # Errors
/// A usage error for kinds that are unknown or not built in; otherwise if no camera answers.
pub fn open(text: &str, console: Console) -> anyhow::Result<OpenCamera> {
    let (kind, name) = text.split_once(':').unwrap_or((text, ""));
    let Some((_, open)) = BUILT.iter().find(|(built, _)| *built == kind) else {
        return Err(unknown(text, kind).into());
    };
    console.say(format!("waiting for {text}"));
    open(name)
}

#[cfg(feature = "orbbec")]
fn orbbec(name: &str) -> anyhow::Result<OpenCamera> {
    if !name.is_empty() {
        let message = format!("--camera-source orbbec:{name}: it takes the first camera");
        return Err(UsageError(message).into());
    }
    Ok(OpenCamera {
        source: Box::new(fgs_orbbec::open()?),
        publisher: None,
    })
}

#[cfg(feature = "realsense")]
fn realsense(name: &str) -> anyhow::Result<OpenCamera> {
    Ok(OpenCamera {
        source: Box::new(fgs_realsense::open(name)?),
        publisher: None,
    })
}

#[cfg(feature = "ros2")]
fn ros2(name: &str) -> anyhow::Result<OpenCamera> {
    let topics = name.parse::<fgs_ros2::Topics>();
    let refusal = |error| UsageError(format!("--camera-source ros2:{name}: {error}"));
    let domain = fgs_ros2::Domain::of_environment()?;
    let (source, publisher) = fgs_ros2::open(domain, &topics.map_err(refusal)?)?;
    Ok(OpenCamera {
        source: Box::new(source),
        publisher: Some(Box::new(publisher)),
    })
}

fn unknown(text: &str, kind: &str) -> UsageError {
    UsageError(if KINDS.contains(&kind) {
        format!(
            "--camera-source {text}: this fgs was built without it; `cargo build --release -p fgs_cli --features \
             {kind}` builds it in"
        )
    } else {
        format!(
            "--camera-source {text}: a kind of camera and its name are expected, such as ros2:/camera (kinds: {})",
            KINDS.join(", ")
        )
    })
}
