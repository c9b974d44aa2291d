//! Serves a page, and a run's stream beside it. A thread for each client, and a limit to all that a client
//! can take: connections, time, bytes of a request.

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

/// An address that is listened at, before there is anything to serve: whether it can be shows before any
/// work. Who connects meanwhile waits.
#[derive(Debug)]
pub struct Listener {
    address: Address,
    socket: TcpListener,
}

impl Listener {
    /// Listens at an address.
    ///
    /// # Errors
    /// If it cannot be listened at.
    pub fn bind(address: &Address) -> io::Result<Self> {
        Ok(Self {
            address: address.clone(),
            socket: TcpListener::bind(&*address.candidates()?)?,
        })
    }
}

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
    /// If no thread starts.
    pub(crate) fn start(
        listener: Listener,
        files: Files,
        live: Option<Arc<LiveState>>,
    ) -> io::Result<Self> {
        let Listener { address, socket } = listener;
        let bound = socket.local_addr()?;
        let access = Access::new(&address, &bound);
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
            .spawn(move || accept(&socket, &accepting))?;
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

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::time::Instant;

    use fgs_splat::{Gaussian, Gaussians};

    use super::*;
    use crate::page::page;

    fn live() -> (Arc<LiveState>, Arc<AtomicBool>) {
        let stop = Arc::new(AtomicBool::new(false));
        (Arc::new(LiveState::new(Arc::clone(&stop))), stop)
    }

    fn start(address: &str, live: Option<Arc<LiveState>>) -> Server {
        let listener = Listener::bind(&address.parse().unwrap()).unwrap();
        Server::start(listener, page(), live).unwrap()
    }

    fn send(server: &Server, head: &str) -> TcpStream {
        let mut stream = TcpStream::connect(("127.0.0.1", server.bound.port())).unwrap();
        stream.write_all(head.as_bytes()).unwrap();
        stream
    }

    /// Status and body.
    fn ask(server: &Server, request: &str, headers: &str) -> (u16, Vec<u8>) {
        let host = if headers.contains("Host:") {
            ""
        } else {
            "Host: localhost\r\n"
        };
        let mut stream = send(
            server,
            &format!("{request} HTTP/1.1\r\n{host}{headers}\r\n"),
        );
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer
            .windows(4)
            .position(|bytes| bytes == b"\r\n\r\n")
            .unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        (head[9..12].parse().unwrap(), answer.split_off(end + 4))
    }

    fn status(server: &Server, request: &str, headers: &str) -> u16 {
        ask(server, request, headers).0
    }

    #[test]
    fn the_page_is_served_and_nothing_else() {
        let server = start("127.0.0.1:0", None);
        assert!(!server.is_open());
        let (ok, index) = ask(&server, "GET /", "");
        assert!(ok == 200 && index.starts_with(b"<!doctype html>"));
        assert_eq!(ask(&server, "GET /index.html?x=1", "").1, index);
        for path in [
            "/no.js",
            "/../Cargo.toml",
            "/stream",
            "//",
            "/web/index.html",
        ] {
            assert_eq!(status(&server, &format!("GET {path}"), ""), 404, "{path}");
        }
        for request in ["POST /", "POST /stop", "DELETE /index.html"] {
            assert_eq!(status(&server, request, ""), 405, "{request}");
        }
        let garbage = send(&server, "\u{1}\u{2}\r\n\r\n").read(&mut [0; 99]);
        assert!(garbage.is_ok());
    }

    #[test]
    fn a_strangers_page_gets_nothing() {
        let (live, stop) = live();
        let server = start("127.0.0.1:0", Some(live));
        for host in ["Host: evil.example\r\n", "Host: 10.1.2.3\r\n", "Host:\r\n"] {
            for request in ["GET /", "GET /stream", "POST /stop"] {
                assert_eq!(status(&server, request, host), 403, "{host}");
            }
        }
        let origin = "Host: localhost:9\r\nOrigin: http://evil.example\r\n";
        assert_eq!(status(&server, "POST /stop", origin), 403);
        assert_eq!(status(&server, "GET /stop", ""), 404);
        assert!(!stop.load(Ordering::Relaxed));
        let origin = "Host: localhost:9\r\nOrigin: http://localhost:9\r\n";
        assert_eq!(status(&server, "POST /stop", origin), 202);
        assert!(stop.load(Ordering::Relaxed));
    }

    #[test]
    fn others_need_the_token() {
        let (live, stop) = live();
        let server = start("0.0.0.0:0", Some(live));
        assert!(server.is_open());
        let path = server.url().splitn(4, '/').nth(3).unwrap();
        assert_eq!(path.len(), 33);
        let wrong = format!("{:032x}/", 0);
        for path in ["", &wrong, &path[1..], &path[..32]] {
            assert_eq!(status(&server, &format!("GET /{path}"), ""), 403);
            assert_eq!(status(&server, &format!("POST /{path}stop"), ""), 403);
        }
        assert_eq!(
            status(&server, &format!("GET /{path}"), "Host: evil.example\r\n"),
            403
        );
        assert!(!stop.load(Ordering::Relaxed));
        assert_eq!(
            status(
                &server,
                &format!("GET /{path}style.css"),
                "Host: 10.1.2.3:4\r\n"
            ),
            200
        );
        assert_eq!(status(&server, &format!("POST /{path}stop"), ""), 202);
        assert!(stop.load(Ordering::Relaxed));
    }

    #[test]
    fn what_is_kept_packed_is_the_same_unpacked() {
        let server = start("127.0.0.1:0", None);
        let request = "GET /vendor/spark-three.min.js";
        let (_, packed) = ask(&server, request, "Accept-Encoding: gzip, br\r\n");
        let (_, plain) = ask(&server, request, "");
        let mut unpacked = Vec::new();
        flate2::read::GzDecoder::new(&*packed)
            .read_to_end(&mut unpacked)
            .unwrap();
        assert!(plain.len() > 2 * packed.len());
        assert_eq!(unpacked, plain);
    }

    fn map(count: usize, x: f32) -> Gaussians {
        let mut map = Gaussians::default();
        for _ in 0..count {
            map.push(&Gaussian {
                mean: [x; 3],
                quat: [1.0, 0.0, 0.0, 0.0],
                scales: [0.01; 3],
                opacity: 0.9,
                rgb: [0.5; 3],
            });
        }
        map
    }

    #[test]
    fn a_client_that_does_not_listen_holds_nobody_up() {
        let (live, _) = live();
        let server = start("127.0.0.1:0", Some(Arc::clone(&live)));
        let mut deaf = send(&server, "GET /stream HTTP/1.1\r\nHost: localhost\r\n\r\n");
        while !live.is_watched() {
            thread::yield_now();
        }
        let start = Instant::now();
        for i in 0..20 {
            let map = map(100_000, i as f32);
            live.change(|scene| scene.splats.update(&map, false));
            thread::sleep(Duration::from_millis(20));
        }
        live.end(None, "over".into());
        live.wait_for_clients(Duration::from_millis(100));
        // All that a client is told in this time would be 60 MB; it has taken what buffers hold.
        assert!(start.elapsed() < PATIENCE, "{:?}", start.elapsed());
        assert!(deaf.read(&mut [0; 16]).unwrap() > 0);
    }

    #[test]
    fn who_comes_late_is_told_everything_and_then_the_end() {
        let (live, _) = live();
        let server = start("127.0.0.1:0", Some(Arc::clone(&live)));
        let map = map(5000, 1.0);
        live.change(|scene| {
            scene.splats.update(&map, false);
            scene.add_loop(1, 2);
            scene.set_up([0.0, 0.0, 1.0]);
            scene.put_picture(crate::watcher::Picture::Depth, vec![7; 10]);
        });
        live.end(Some(&map), "over".into());
        let (ok, body) = ask(&server, "GET /stream", "");
        assert_eq!(ok, 200);
        let (mut rest, mut kinds, mut splats, mut news) = (&body[..], Vec::new(), 0, String::new());
        while let Some((head, after)) = rest.split_at_checked(5) {
            let length = u32::from_le_bytes(head[..4].try_into().unwrap()) as usize;
            let (content, after) = after.split_at(length);
            kinds.push(head[4]);
            match head[4] {
                1 => news = String::from_utf8(content.to_vec()).unwrap(),
                2 => splats += (content.len() - 8) / 32,
                3 => assert_eq!(content, [[2_u8].as_slice(), &[7; 10]].concat()),
                _ => {}
            }
            rest = after;
        }
        assert_eq!((splats, kinds.last()), (5000, Some(&5)));
        for part in [
            r#""loops":[[1,2]]"#,
            r#""up":[0.0,0.0,1.0]"#,
            r#""message":"over""#,
        ] {
            assert!(news.contains(part), "{news}");
        }
    }
}
