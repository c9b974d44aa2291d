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

/// Kinds, which are the features that they are built with.
const KINDS: [&str; 2] = ["realsense", "ros2"];

/// Those that are built in.
const BUILT: &[&str] = &[
    #[cfg(feature = "realsense")]
    "realsense",
    #[cfg(feature = "ros2")]
    "ros2",
];

/// Opens a camera and waits until it is there.
///
/// # Errors
/// A usage error for kinds that are unknown or not built in; otherwise if no camera answers.
pub fn open(text: &str, console: Console) -> anyhow::Result<OpenCamera> {
    let (kind, name) = text.split_once(':').unwrap_or((text, ""));
    if !BUILT.contains(&kind) {
        return Err(unknown(kind, name).into());
    }
    console.say(format!("waiting for {text}"));
    match kind {
        #[cfg(feature = "realsense")]
        "realsense" => Ok(OpenCamera {
            source: Box::new(fgs_realsense::open(name)?),
            publisher: None,
        }),
        #[cfg(feature = "ros2")]
        "ros2" => {
            let topics = name.parse::<fgs_ros2::Topics>();
            let topics = topics
                .map_err(|error| UsageError(format!("--camera-source {kind}:{name}: {error}")))?;
            let (source, publisher) = fgs_ros2::open(fgs_ros2::Domain::of_environment()?, &topics)?;
            Ok(OpenCamera {
                source: Box::new(source),
                publisher: Some(Box::new(publisher)),
            })
        }
        _ => Err(unknown(kind, name).into()),
    }
}

fn unknown(kind: &str, name: &str) -> UsageError {
    UsageError(if KINDS.contains(&kind) {
        format!(
            "--camera-source {kind}:{name}: this fgs was built without it; `cargo build --release -p fgs_cli \
             --features {kind}` builds it in"
        )
    } else {
        format!(
            "--camera-source {kind}: a kind of camera and its name are expected, such as ros2:/camera (kinds: {})",
            KINDS.join(", ")
        )
    })
}
