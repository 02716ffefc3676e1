// Thread pool that shares the items of a range, for many calls per second.
#pragma once

#include <atomic>
#include <barrier>
#include <cstddef>
#include <functional>
#include <thread>
#include <vector>

namespace leglab::loop {

// The calling thread is one of the `count` threads. The assignment of items to threads differs from
// call to call, so the work on one item must not access data of another.
class Threads {
 public:
  // count: at least 1.
  explicit Threads(int count) : turn_(count) {
    for (int i = 1; i < count; ++i) others_.emplace_back([this, i] { serve(std::size_t(i)); });
  }

  ~Threads() {
    work_ = nullptr;
    turn_.arrive_and_wait();
    for (std::thread& other : others_) other.join();
  }

  Threads(const Threads&) = delete;
  Threads& operator=(const Threads&) = delete;

  std::size_t size() const { return others_.size() + 1; }

  using Work = std::function<void(std::size_t item, std::size_t thread)>;

  // Calls `work` for the items 0 to count - 1, each once, and returns when all are done.
  void each(std::size_t count, const Work& work) {
    work_ = &work;
    count_ = count;
    next_ = 0;
    turn_.arrive_and_wait();
    take(0);
    turn_.arrive_and_wait();
  }

 private:
  void take(std::size_t thread) {
    for (std::size_t i = next_++; i < count_; i = next_++) (*work_)(i, thread);
  }

  void serve(std::size_t thread) {
    for (;;) {
      turn_.arrive_and_wait();
      if (!work_) return;  // the pool ends
      take(thread);
      turn_.arrive_and_wait();
    }
  }

  std::barrier<> turn_;  // passed by all threads at the start and at the end of a call
  const Work* work_ = nullptr;
  std::size_t count_ = 0;
  std::atomic<std::size_t> next_{0};
  std::vector<std::thread> others_;
};

}  // namespace leglab::loop
