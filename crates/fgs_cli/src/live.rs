//! `--live`: a run that can be watched in a browser.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::Args;
use fgs_run::{Plan, RunError, RunEvent, RunObserver, RunResult};
use fgs_slam::Slam;
use fgs_view::{Address, Listener, LiveView};
use serde_json::json;

use crate::console::{Console, complain};
use crate::progress::Progress;

/// The option.
#[derive(Debug, Args)]
pub struct Live {
    /// Show the run at work in a browser. With an address other machines can look on, too, if they know the
    /// token that is printed [default: 127.0.0.1:7070]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1)]
    live: Option<Option<Address>>,
}

impl Live {
    /// Listens for browsers, if a page is wanted. Comes before anything is written.
    ///
    /// # Errors
    /// If the address cannot be listened at.
    pub fn listen(&self) -> anyhow::Result<Option<Listener>> {
        let Some(address) = &self.live else {
            return Ok(None);
        };
        let address = address.clone().unwrap_or_default();
        let listener = Listener::bind(&address)
            .with_context(|| format!("--live: cannot listen at {address}"))?;
        Ok(Some(listener))
    }
}

/// Serves the page of a run, and says where it is.
///
/// # Errors
/// If no thread starts.
pub fn start(
    listener: Listener,
    title: &str,
    plan: &Plan,
    console: Console,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<LiveView> {
    let (camera, frames) = (plan.input.camera(), plan.num_frames_left().unwrap_or(0));
    let view = LiveView::start(listener, title, camera, frames, Arc::clone(stop))
        .context("--live: cannot serve a page")?;
    let url = view.server().url();
    console.event("live", json!({ "url": url }));
    console.say(format!("live page  {url}"));
    Ok(view)
}

/// All who look on: at the terminal, in a browser, and at the camera's end.
pub struct Watchers {
    /// The terminal.
    pub progress: Progress,
    /// The browser, if there is one.
    pub live: Option<LiveView>,
    /// The program that the camera's images come from, if it wants the results.
    pub publisher: Option<Box<dyn RunObserver>>,
}

impl Watchers {
    /// The run has ended.
    pub fn end(self, plan: &Plan, result: &Result<RunResult, RunError>) {
        drop(self.progress);
        let Some(view) = self.live else { return };
        match result {
            Ok(result) => {
                let folder = plan.folder.path().display();
                let map = result.refined.as_ref().unwrap_or(&result.gaussians);
                let message = format!("results in {folder}: fgs view {folder}");
                view.end(Some(map), message);
            }
            Err(error) => view.end(None, error.to_string()),
        }
    }
}

impl RunObserver for Watchers {
    fn begin(&mut self, session: &Slam) {
        if let Some(Err(error)) = self.live.as_mut().map(|view| view.watch(session)) {
            complain(format_args!("warning: the live page stays empty: {error}"));
            self.live = None;
        }
        if let Some(publisher) = &mut self.publisher {
            publisher.begin(session);
        }
    }

    fn on(&mut self, event: &RunEvent<'_>) {
        self.progress.on(event);
        if let Some(publisher) = &mut self.publisher {
            publisher.on(event);
        }
        if let (Some(view), RunEvent::Scored { done, total }) = (&self.live, event) {
            view.phase("scoring", *done, *total);
        }
    }
}
