// serial_adapter: a serial CAN adapter (SLCAN) in software, for vcan_machine.sh: a pseudo-terminal
// whose other end the kernel's slcan driver takes for one. Prints the interface's name. A line on
// standard input makes it say that its controller is in a state: "off", "passive", "active";
// "stall" makes it read no more, "read" again. With a bus it is a bridge between the interface and
// that bus.
#include <fcntl.h>
#include <linux/tty.h>
#include <net/if.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string>

#include "robot_client/can/bus_address.h"

namespace robostress {
namespace {

int OpenTerminal() {
  const int master = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
  if (master < 0 || grantpt(master) != 0 || unlockpt(master) != 0) return -1;
  const int slave = open(ptsname(master), O_RDWR | O_NOCTTY);
  termios raw{};
  if (slave < 0 || tcgetattr(slave, &raw) != 0) return -1;
  cfmakeraw(&raw);
  tcsetattr(slave, TCSANOW, &raw);
  tcgetattr(master, &raw);
  cfmakeraw(&raw);
  tcsetattr(master, TCSANOW, &raw);
  const int discipline = N_SLCAN;
  ifreq interface {};
  if (ioctl(slave, TIOCSETD, &discipline) != 0 || ioctl(slave, SIOCGIFNAME, &interface) != 0)
    return -1;
  std::printf("%s\n", interface.ifr_name);
  std::fflush(stdout);
  return master;
}

// "t15181122334455667788\r": identifier, length, data.
bool Parse(const std::string& line, CanFrame& frame) {
  unsigned id = 0, size = 0;
  if (std::sscanf(line.c_str(), "t%3x%1x", &id, &size) != 2 || size > 8 ||
      line.size() < 5 + 2 * size)
    return false;
  frame = {};
  frame.id = static_cast<uint16_t>(id);
  frame.size = static_cast<uint8_t>(size);
  for (unsigned i = 0; i < size; ++i) {
    unsigned byte = 0;
    if (std::sscanf(line.c_str() + 5 + 2 * i, "%2x", &byte) != 1) return false;
    frame.data[i] = static_cast<uint8_t>(byte);
  }
  return true;
}

std::string Print(const CanFrame& frame) {
  char text[32];
  int size = std::snprintf(text, sizeof text, "t%03X%d", frame.id, frame.size);
  for (int i = 0; i < frame.size; ++i)
    size +=
        std::snprintf(text + size, sizeof text - static_cast<size_t>(size), "%02X", frame.data[i]);
  return std::string(text, static_cast<size_t>(size)) + "\r";
}

// What the terminal does not take at once waits; frames beyond that are lost, as in an adapter.
class Output {
 public:
  explicit Output(int master) : master_(master) {}
  void Add(const std::string& text, bool may_be_lost) {
    if (!may_be_lost || waiting_.size() < 2048) waiting_ += text;
    Flush();
  }
  void Flush() {
    const ssize_t size = write(master_, waiting_.data(), waiting_.size());
    if (size > 0) waiting_.erase(0, static_cast<size_t>(size));
  }

 private:
  const int master_;
  std::string waiting_;
};

// "sb255255\r": state (a, w, p, b) and the counts of errors received and sent.
void Obey(Output& output, const std::string& word, bool& reading, bool& on_bus) {
  if (word == "off") on_bus = false;  // hears nothing either, until it is opened again
  if (word == "off") output.Add("sb255255\r", false);
  if (word == "passive") output.Add("sp128128\r", false);
  if (word == "active") output.Add("sa000000\r", false);
  if (word == "stall") reading = false;
  if (word == "read") reading = true;
}

void Serve(int master, CanBus* bus) {
  bool reading = true, on_bus = true;
  Output output(master);
  std::string from_driver, typed;
  char bytes[4096];
  while (true) {
    pollfd ready[2] = {{STDIN_FILENO, POLLIN, 0}, {reading ? master : -1, POLLIN, 0}};
    poll(ready, 2, 1);
    if (ready[0].revents != 0) {
      const ssize_t size = read(STDIN_FILENO, bytes, sizeof bytes);
      if (size <= 0) return;
      typed.append(bytes, static_cast<size_t>(size));
      for (size_t end; (end = typed.find('\n')) != std::string::npos; typed.erase(0, end + 1))
        Obey(output, typed.substr(0, end), reading, on_bus);
    }
    for (ssize_t size; reading && (size = read(master, bytes, sizeof bytes)) > 0;)
      from_driver.append(bytes, static_cast<size_t>(size));
    for (size_t end; (end = from_driver.find('\r')) != std::string::npos;
         from_driver.erase(0, end + 1)) {
      CanFrame frame;
      if (from_driver[0] == 'O') on_bus = true;
      if (on_bus && Parse(from_driver.substr(0, end), frame) && bus != nullptr)
        bus->Send(frame).IgnoreError();
    }
    StampedFrame arrived;
    for (int i = 0; i < 64 && bus != nullptr && bus->Receive(arrived); ++i)
      if (on_bus) output.Add(Print(arrived.frame), true);
    output.Flush();
  }
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::MonotonicClock clock;
  std::unique_ptr<robostress::CanBus> bus;
  if (argc > 1) {
    auto made = robostress::MakeCanBus(argv[1], clock);
    const absl::Status status = made.ok() ? (*made)->Open() : made.status();
    if (!status.ok()) {
      std::fprintf(stderr, "serial_adapter: %s\n", std::string(status.message()).c_str());
      return 2;
    }
    bus = *std::move(made);
  }
  const int master = robostress::OpenTerminal();
  if (master < 0) {
    std::perror("serial_adapter: a terminal with the kernel's slcan driver (modprobe slcan)");
    return 2;
  }
  robostress::Serve(master, bus.get());
  return 0;
}
