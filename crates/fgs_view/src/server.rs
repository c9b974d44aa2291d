//! Serves a page, and a run's stream beside it.

use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::access::{Access, Address};
use crate::live_state::LiveState;
use crate::page::Files;
use crate::request::Request;
use crate::response::{write_file, write_head, write_text};

/// Whoever takes longer to send a request, or to take what is sent, is cut off.
const PATIENCE: Duration = Duration::from_secs(10);
/// A browser opens six at a time.
const MAX_CONNECTIONS: usize = 48;

/// A server at work; dropping it ends it.
pub struct Server {
    bound: SocketAddr,
    url: String,
    state: Arc<State>,
    thread: Option<JoinHandle<()>>,
}

struct State {
    access: Access,
    files: Files,
    live: Option<Arc<LiveState>>,
    connections: AtomicUsize,
    has_ended: AtomicBool,
}

impl Server {
    /// Serves files, and a run if there is one.
    ///
    /// # Errors
    /// If the address cannot be listened at.
    pub(crate) fn start(
        address: &Address,
        files: Files,
        live: Option<Arc<LiveState>>,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind(&*address.candidates()?)?;
        let bound = listener.local_addr()?;
        let access = Access::new(address, &bound);
        let url = format!("http://{bound}{}", access.root());
        let state = Arc::new(State {
            access,
            files,
            live,
            connections: AtomicUsize::new(0),
            has_ended: AtomicBool::new(false),
        });
        let accepting = Arc::clone(&state);
        let thread = thread::Builder::new()
            .name("server".into())
            .spawn(move || accept(&listener, &accepting))?;
        Ok(Self {
            bound,
            url,
            state,
            thread: Some(thread),
        })
    }

    /// Where the page is.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Whether others can reach it.
    pub fn is_open(&self) -> bool {
        !self.bound.ip().is_loopback()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.state.has_ended.store(true, Ordering::Relaxed);
        if let Some(live) = &self.state.live {
            live.close();
        }
        // The thread waits for somebody to connect.
        let here: IpAddr = match self.bound.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        let woken = TcpStream::connect_timeout(&(here, self.bound.port()).into(), PATIENCE);
        if let (Ok(_), Some(thread)) = (woken, self.thread.take()) {
            // A panic there was its own.
            let _ = thread.join();
        }
    }
}

fn accept(listener: &TcpListener, state: &Arc<State>) {
    for stream in listener.incoming() {
        if state.has_ended.load(Ordering::Relaxed) {
            return;
        }
        let Ok(mut stream) = stream else {
            // Out of file handles, perhaps: for a moment, not in a circle.
            thread::sleep(Duration::from_millis(50));
            continue;
        };
        let in_time = stream
            .set_read_timeout(Some(PATIENCE))
            .and_then(|()| stream.set_write_timeout(Some(PATIENCE)))
            .and_then(|()| stream.set_nodelay(true));
        if in_time.is_err() {
            continue;
        }
        let connection = Connection::new(Arc::clone(state));
        if state.connections.load(Ordering::Relaxed) <= MAX_CONNECTIONS {
            // Where no thread starts, the client is turned away.
            let _ = thread::Builder::new().name("client".into()).spawn(move || {
                // Somebody who goes away in the middle is no error of ours.
                let _ = serve(&mut stream, &connection.0);
            });
        }
    }
}

/// Counts as one as long as it lives.
struct Connection(Arc<State>);

impl Connection {
    fn new(state: Arc<State>) -> Self {
        state.connections.fetch_add(1, Ordering::Relaxed);
        Self(state)
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::Relaxed);
    }
}

fn serve(stream: &mut TcpStream, state: &State) -> io::Result<()> {
    let Some(request) = Request::read(stream) else {
        return write_text(stream, "400 Bad Request");
    };
    respond(&request, stream, state)
}

fn respond(request: &Request, out: &mut impl Write, state: &State) -> io::Result<()> {
    if !state.access.is_host(&request.host) {
        return write_text(out, "403 Forbidden");
    }
    let Some(path) = state.access.path_of(&request.path) else {
        return write_text(out, "403 Forbidden");
    };
    match (request.method.as_str(), path, &state.live) {
        ("GET", "stream", Some(live)) => {
            write_head(out, "200 OK", "application/octet-stream", None, false)?;
            live.stream(out)
        }
        ("POST", "stop", Some(live)) => {
            // Without an origin it is no page: someone at a terminal.
            let own = format!("http://{}", request.host);
            if request.origin.as_ref().is_some_and(|origin| *origin != own) {
                return write_text(out, "403 Forbidden");
            }
            live.stop();
            write_text(out, "202 Accepted")
        }
        ("GET", path, _) => {
            let name = if path.is_empty() { "index.html" } else { path };
            match state.files.get(name) {
                Some(file) => write_file(out, file, request.accepts_gzip),
                None => write_text(out, "404 Not Found"),
            }
        }
        _ => write_text(out, "405 Method Not Allowed"),
    }
}
