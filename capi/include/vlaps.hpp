// libvlaps in C++17: members and ports that close themselves, errors as exceptions.
// docs/foreign.md explains the calls.
#ifndef VLAPS_HPP
#define VLAPS_HPP

#include <cstdint>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "vlaps.h"

namespace vlaps {

/// A call that failed; `kind` is one of enum vlaps_kind.
class error : public std::runtime_error {
  public:
    error(int kind, const std::string &text) : std::runtime_error(text), kind(kind) {}
    int kind;
};

/// The answer of a call (enum vlaps_answer), or an exception with the library's text.
inline int checked(int answer) {
    if (answer < 0) throw error(answer, vlaps_last_error());
    return answer;
}

/// A port of a service. `M` is the service's message; its length is checked.
template <class M> class port {
    static_assert(std::is_trivially_copyable<M>::value, "a message of vlaps.h");

  public:
    port(port &&other) noexcept : number_(std::exchange(other.number_, -1)) {}
    port &operator=(port &&other) noexcept {
        std::swap(number_, other.number_);
        return *this;
    }
    ~port() {
        if (number_ >= 0) vlaps_close(number_);
    }

  protected:
    port(const char *service, uint32_t use) : number_(checked(vlaps_open(service, use))) {}
    int number_;
};

/// Reads the newest message of a service, or with VLAPS_EVERY each of a queue.
template <class M> class reader : public port<M> {
  public:
    explicit reader(const char *service, uint32_t use = VLAPS_NEWEST)
        : port<M>(service, use) {}
    /// Whether a new admissible message was copied.
    bool newest(M &message) {
        return checked(vlaps_newest(this->number_, &message, sizeof message)) == VLAPS_OK;
    }
    bool next(M &message) {
        return checked(vlaps_next(this->number_, &message, sizeof message)) == VLAPS_OK;
    }
};

/// Publishes a service.
template <class M> class writer : public port<M> {
  public:
    explicit writer(const char *service) : port<M>(service, VLAPS_WRITE) {}
    /// Throws when the check refuses the message; nothing is sent then.
    void publish(const M &message) {
        checked(vlaps_publish(this->number_, &message, sizeof message));
    }
};

/// The membership of this process in its run. Open ports after it; they close first.
/// Members and ports are not to be static: at exit the library may be gone before them.
class member {
  public:
    member(const char *process, int argc, char **argv) {
        checked(vlaps_join(process, argc, argv));
    }
    member(const member &) = delete;
    member &operator=(const member &) = delete;
    ~member() { vlaps_leave(); }

    /// Whether to go on; sleeps until a message comes, at most `limit_ns` and 20 ms.
    bool wait(uint64_t limit_ns = UINT64_MAX) { return checked(vlaps_wait(limit_ns)) == VLAPS_OK; }
    /// A number of the configuration, such as "scanner.range_m".
    double setting(const std::string &key) const {
        double number = 0;
        checked(vlaps_setting(key.c_str(), &number));
        return number;
    }
    bool is_lockstep() const { return checked(vlaps_is_lockstep()) == 1; }
    uint64_t now_ns() const { return vlaps_now_ns(); }
    /// The process id that the run names for a process; 0 for none.
    int64_t pid_of(const char *process) const {
        const int64_t pid = vlaps_pid_of(process);
        checked(pid < 0 ? static_cast<int>(pid) : 0);
        return pid;
    }

    /// For a world: writes the run's scanner into an observation. Returns where each beam
    /// looks, rad counter-clockwise from the heading of the body; the beams begin at
    /// scanner_x_body_m, scanner_y_body_m.
    std::vector<double> beams(vlaps_observation &observation) const {
        std::vector<double> directions_rad(VLAPS_BEAMS_MAX);
        checked(vlaps_beams(&observation, directions_rad.data(), directions_rad.size()));
        directions_rad.resize(observation.beam_count);
        return directions_rad;
    }

    /// A world's next instant; false: exit with 0.
    bool await_tick(vlaps_tick &tick) { return checked(vlaps_await_tick(&tick)) == VLAPS_OK; }
    /// The world's answer to it; false: exit with 0.
    bool finish_tick(const vlaps_observation &observation, const vlaps_progress &progress) {
        return checked(vlaps_finish_tick(&observation, &progress)) == VLAPS_OK;
    }
    /// A planner's next observation; false: exit with 0.
    bool await_observation(vlaps_observation &observation) {
        return checked(vlaps_await_observation(&observation)) == VLAPS_OK;
    }
    /// The plan for it.
    void answer(const vlaps_plan &plan) { checked(vlaps_answer(&plan)); }
};

/// Runs a program's main and turns an exception into one line and exit code 2, which the
/// supervisor reads as a set-up that would fail again.
template <class F> int run(const char *name, F body) {
    try {
        body();
        return 0;
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s: %s\n", name, error.what());
        return 2;
    }
}

} // namespace vlaps

#endif
