"""Chromium without a window, spoken to through its pipe: opens a page, runs scripts in it, takes
pictures of it, and notes what it asks the network for."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
import sys
import time

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATH = next((found for name in NAMES if (found := shutil.which(name))), None)
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1200,760",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--remote-debugging-pipe",
]
# The browser reads from 3 and writes to 4.
BEGIN = """
import os, sys
for own, place in zip(map(int, sys.argv[1:3]), (3, 4)):
    os.dup2(own, place)
os.execv(sys.argv[3], sys.argv[3:])
"""


class Page:
    def __init__(self, send, receive):
        self.send, self.receive, self.count, self.left = send, receive, 0, b""
        self.asked, self.faults, self.session = [], [], None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.send, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.message()
            if answer.get("id") == self.count:
                assert "error" not in answer, answer
                return answer["result"]
            if answer.get("method") == "Network.requestWillBeSent":
                self.asked.append(answer["params"]["request"]["url"])
            if answer.get("method") == "Runtime.exceptionThrown":
                self.faults.append(answer["params"])

    def message(self):
        while b"\0" not in self.left:
            self.left += os.read(self.receive, 1 << 20)
        own, _, self.left = self.left.partition(b"\0")
        return json.loads(own)

    def run(self, script):
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, script, seconds=90.0):
        end = time.monotonic() + seconds
        while not (found := self.run(script)):
            assert time.monotonic() < end, f"{script} stays {found}; {self.faults}"
            time.sleep(0.2)
        return found

    def picture(self):
        return base64.b64decode(self.call("Page.captureScreenshot")["data"])


@contextlib.contextmanager
def opened(path, folder):
    """A page, its scripts run; closed at the end."""
    to_browser, from_browser = os.pipe(), os.pipe()
    own = {to_browser[0], from_browser[1]}
    ends = [str(to_browser[0]), str(from_browser[1])]
    process = subprocess.Popen(
        [sys.executable, "-c", BEGIN, *ends, PATH, *FLAGS, f"--user-data-dir={folder}"],
        pass_fds=own,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    for one in own:
        os.close(one)
    try:
        page = Page(to_browser[1], from_browser[0])
        page.call("Page.navigate", url=f"file://{path}")
        yield page
    finally:
        process.terminate()
        process.wait(20)
        os.close(to_browser[1])
        os.close(from_browser[0])
