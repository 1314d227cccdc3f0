//! A real browser without a window, driven by its own protocol over two pipes: the
//! tests of the page need nothing else.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

/// Programs that are tried; Debian's package of the first is `chromium-headless-shell`.
const PROGRAMS: [&str; 4] = [
    "chromium-headless-shell",
    "chromium",
    "chromium-browser",
    "google-chrome",
];

/// A browser with one page.
pub struct Browser {
    child: Child,
    to: File,
    from: BufReader<File>,
    session: String,
    last: u64,
    /// What went wrong on the page: exceptions, refused resources.
    pub troubles: Vec<String>,
    _folder: tempfile::TempDir,
}

impl Browser {
    /// Starts one; `None`, with the reason printed, where no browser is installed.
    pub fn start() -> Option<Self> {
        let works = |program: &&&str| {
            let mut command = Command::new(program);
            command
                .arg("--version")
                .stdout(Stdio::null())
                .stderr(Stdio::null());
            command.status().is_ok_and(|status| status.success())
        };
        let Some(program) = PROGRAMS.iter().find(works) else {
            // Written to the terminal, because a skipped test must not look passed.
            let _ = writeln!(
                std::io::stderr(),
                "skipped: no browser is installed (apt install chromium-headless-shell)"
            );
            return None;
        };
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = |name: &str| {
            let path = folder.path().join(name);
            let made = Command::new("mkfifo").arg(&path).status().expect("mkfifo");
            assert!(made.success());
            path
        };
        let (to, from) = (pipe("to"), pipe("from"));
        let profile = folder.path().join("profile");
        // The protocol is on the descriptors 3 and 4. No sandbox: in a container there is
        // none to be had, and the page is ours.
        let child = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<\"$TO\" 4>\"$FROM\"", program])
            .args(["--remote-debugging-pipe", "--headless", "--no-sandbox"])
            .args(["--disable-gpu", "--no-first-run", "--disable-dev-shm-usage"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .env("TO", &to)
            .env("FROM", &from)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the browser starts");
        let mut browser = Self {
            child,
            // Each waits for the other end.
            to: OpenOptions::new().write(true).open(&to).expect("a pipe"),
            from: BufReader::new(File::open(&from).expect("a pipe")),
            session: String::new(),
            last: 0,
            troubles: Vec::new(),
            _folder: folder,
        };
        let page = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": page["targetId"], "flatten": true});
        let session = browser.call("Target.attachToTarget", attach);
        browser.session = session["sessionId"].as_str().expect("a session").into();
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        Some(browser)
    }

    /// Calls a method of the protocol and returns its result.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        let answer = self.ask(method, parameters);
        assert!(answer["error"].is_null(), "{method}: {answer}");
        answer["result"].clone()
    }

    /// The answer to a call: `result` or `error`.
    fn ask(&mut self, method: &str, parameters: Value) -> Value {
        self.last += 1;
        let id = self.last;
        let mut message = json!({"id": id, "method": method, "params": parameters});
        if !self.session.is_empty() {
            message["sessionId"] = self.session.clone().into();
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.to.write_all(&bytes).expect("the browser listens");
        loop {
            let mut bytes = Vec::new();
            self.from.read_until(0, &mut bytes).expect("an answer");
            assert_eq!(bytes.pop(), Some(0), "the browser has ended");
            let answer: Value = serde_json::from_slice(&bytes).expect("JSON");
            if answer["id"] == id {
                return answer;
            }
            self.note(&answer);
        }
    }

    fn note(&mut self, event: &Value) {
        let told = &event["params"];
        match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => {
                self.troubles.push(told["exceptionDetails"].to_string());
            }
            Some("Log.entryAdded") if told["entry"]["level"] == "error" => {
                self.troubles.push(told["entry"].to_string());
            }
            _ => {}
        }
    }

    /// Opens a page.
    pub fn open(&mut self, url: &str) {
        self.call("Page.navigate", json!({"url": url}));
    }

    /// Sets the size of the window, px, and the user's choice of `dark` or `light`.
    pub fn look(&mut self, (width, height): (u32, u32), scheme: &str) {
        let metrics = json!({
            "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600
        });
        self.call("Emulation.setDeviceMetricsOverride", metrics);
        let feature = json!({"name": "prefers-color-scheme", "value": scheme});
        self.call("Emulation.setEmulatedMedia", json!({"features": [feature]}));
    }

    /// The value of an expression on the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let asked = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let answer = self.call("Runtime.evaluate", asked);
        assert!(
            answer["exceptionDetails"].is_null(),
            "{expression}: {answer}"
        );
        answer["result"]["value"].clone()
    }

    /// Polls until an expression is true.
    ///
    /// # Panics
    /// After a minute without it, which is no limit of speed but ends a test that waits
    /// in vain.
    pub fn until(&mut self, expression: &str) {
        for _ in 0..1_200 {
            let asked =
                json!({"expression": format!("Boolean({expression})"), "returnByValue": true});
            // While a page is being opened there may be nothing to ask.
            let answer = self.ask("Runtime.evaluate", asked);
            if answer["result"]["result"]["value"] == true {
                return;
            }
            std::thread::park_timeout(Duration::from_millis(50));
        }
        let text = self.value("document.body.innerText");
        panic!(
            "waited a minute in vain until {expression}; troubles {:?}; page: {text}",
            self.troubles
        );
    }

    /// Presses a key, such as `n` or `ArrowRight`.
    pub fn press(&mut self, key: &str) {
        let text = if key.chars().count() == 1 { key } else { "" };
        for kind in ["keyDown", "keyUp"] {
            let event = json!({"type": kind, "key": key, "text": text});
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// The text of an element.
    pub fn text(&mut self, id: &str) -> String {
        let text = self.value(&format!("document.getElementById('{id}').innerText"));
        text.as_str().unwrap_or_default().into()
    }

    /// Different colours of a canvas: one where nothing is drawn.
    pub fn colors(&mut self, id: &str) -> u64 {
        let count = self.value(&format!(
            "(() => {{ const canvas = document.getElementById('{id}'); \
             const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
             return new Set(new Uint32Array(pixels.data.buffer)).size; }})()"
        ));
        count.as_u64().unwrap_or(0)
    }

    /// Writes a picture of the page as PNG, for a person to look at.
    pub fn picture(&mut self, path: &Path) {
        use base64::Engine as _;
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"}));
        let text = shot["data"].as_str().expect("a picture");
        let bytes = base64::engine::general_purpose::STANDARD.decode(text);
        std::fs::write(path, bytes.expect("base64")).expect("a file");
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
