//! Runs and maps in a browser, from a machine without a screen.
//!
//! Both are one page of plain files (`web/`), which shows splats with Spark and three.js, in the
//! repository with their licences, so that it works offline. [`Site`] is a finished map: pages to be
//! served, or written to a folder for any web server. [`LiveView`] is a run at work. What there is to see of
//! one is found by [`watch`], from a thread of its own, for any [`Audience`].
//!
//! [`Server`] is a few threads over the standard library's sockets: it answers with files, and with one stream
//! of what changes. Every limit is one of its own: time to wait for a client, size of a request, number
//! of clients.

mod access;
mod live_state;
mod live_view;
mod page;
mod pictures;
mod request;
mod response;
mod server;
mod site;
mod splat_chunks;
mod watcher;

pub use access::Address;
pub use live_view::LiveView;
pub use request::Request;
pub use server::{Listener, Server};
pub use site::{KeyframePictures, Site, SiteKeyframe, Summary};
pub use watcher::{Audience, Picture, Render, picture_camera, watch};
