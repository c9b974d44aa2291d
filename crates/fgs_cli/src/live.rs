//! Those who look on while a run works: at the terminal, with `--live` in a browser, with `--rerun` in Rerun.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::Args;
#[cfg(feature = "rerun")]
use fgs_rerun::{Outputs, RerunView};
use fgs_run::{Plan, RunError, RunEvent, RunObserver, RunResult};
use fgs_slam::Slam;
use fgs_view::{Address, Listener, LiveView};
use serde_json::json;

use crate::console::{Console, complain};
use crate::progress::Progress;
#[cfg(feature = "rerun")]
use crate::rerun::{self, Rerun};

/// The options.
#[derive(Debug, Args)]
pub struct Live {
    /// Show the run at work in a browser. With an address other machines can look on, too, if they know the
    /// token that is printed [default: 127.0.0.1:7070]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1)]
    live: Option<Option<Address>>,
    #[cfg(feature = "rerun")]
    #[command(flatten)]
    rerun: Rerun,
}

impl Live {
    /// Listens for browsers and turns to Rerun, as far as they are wanted. Comes before a run's folder is
    /// touched.
    ///
    /// # Errors
    /// If an address cannot be listened at, or Rerun not be shown anything.
    pub fn listen(&self) -> anyhow::Result<Onlookers> {
        let listen = |address: &Option<Address>| {
            let address = address.clone().unwrap_or_default();
            Listener::bind(&address).with_context(|| format!("--live: cannot listen at {address}"))
        };
        Ok(Onlookers {
            listener: self.live.as_ref().map(listen).transpose()?,
            #[cfg(feature = "rerun")]
            rerun: self.rerun.open()?,
            publisher: None,
        })
    }
}

/// All who want to look on.
pub struct Onlookers {
    listener: Option<Listener>,
    #[cfg(feature = "rerun")]
    rerun: Option<Outputs>,
    /// The program that a live camera's images come from, if it wants the results.
    pub publisher: Option<Box<dyn RunObserver>>,
}

impl Onlookers {
    /// Serves the page of a run, and says where it is.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn watchers(
        self,
        title: &str,
        plan: &Plan,
        console: Console,
        stop: &Arc<AtomicBool>,
    ) -> anyhow::Result<Watchers> {
        let (camera, frames) = (plan.input.camera(), plan.num_frames_left());
        let start = |listener| {
            let frames = frames.unwrap_or(0);
            let view = LiveView::start(listener, title, camera, frames, Arc::clone(stop))
                .context("--live: cannot serve a page")?;
            let url = view.server().url();
            console.event("live", json!({ "url": url }));
            console.say(format!("live page  {url}"));
            anyhow::Ok(view)
        };
        Ok(Watchers {
            live: self.listener.map(start).transpose()?,
            #[cfg(feature = "rerun")]
            rerun: self
                .rerun
                .map(|outputs| RerunView::start(outputs, title, camera))
                .transpose()?,
            publisher: self.publisher,
            progress: Progress::new(frames, console),
        })
    }
}

/// All who look on: at the terminal, in a browser, in Rerun, and at the camera's end.
pub struct Watchers {
    /// The terminal.
    progress: Progress,
    /// The browser, if there is one.
    live: Option<LiveView>,
    /// Rerun, if it is wanted.
    #[cfg(feature = "rerun")]
    rerun: Option<RerunView>,
    publisher: Option<Box<dyn RunObserver>>,
}

impl Watchers {
    /// The run has ended.
    pub fn end(self, plan: &Plan, result: &Result<RunResult, RunError>) {
        drop(self.progress);
        #[cfg(feature = "rerun")]
        if let Some(Err(error)) = self.rerun.map(|view| rerun::end(view, plan, result)) {
            complain(format_args!(
                "warning: Rerun has not got everything: {error}"
            ));
        }
        let Some(view) = self.live else { return };
        match result {
            Ok(result) => {
                let folder = plan.folder.path().display();
                let message = format!("results in {folder}: fgs view {folder}");
                view.end(Some(result.finest_map()), message);
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
        #[cfg(feature = "rerun")]
        if let Some(Err(error)) = self.rerun.as_mut().map(|view| view.watch(session)) {
            complain(format_args!("warning: Rerun shows nothing: {error}"));
            self.rerun = None;
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
