// Threads that share the items of a range, called many times a second.
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace leglab::loop {

// Whoever calls works too: with one thread there are no others. Which thread takes which item
// differs from call to call, so an item must touch nothing of another.
class Threads {
 public:
  explicit Threads(int count) {
    for (int i = 1; i < count; ++i) {
      others_.emplace_back([this, i] { wait(std::size_t(i)); });
    }
  }

  ~Threads() {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    begin_.notify_all();
    for (std::thread& other : others_) other.join();
  }

  Threads(const Threads&) = delete;
  Threads& operator=(const Threads&) = delete;

  std::size_t size() const { return others_.size() + 1; }

  using Work = std::function<void(std::size_t item, std::size_t thread)>;

  // Calls `work` for the items 0 to count - 1, each once, and returns when all are done.
  void each(std::size_t count, const Work& work) {
    {
      const std::lock_guard lock(mutex_);
      work_ = &work;
      count_ = count;
      next_ = 0;
      busy_ = others_.size();
      ++round_;
    }
    begin_.notify_all();
    take(0);
    std::unique_lock lock(mutex_);
    end_.wait(lock, [this] { return busy_ == 0; });
  }

 private:
  void take(std::size_t thread) {
    for (std::size_t i = next_++; i < count_; i = next_++) (*work_)(i, thread);
  }

  void wait(std::size_t thread) {
    for (long seen = 0;;) {
      {
        std::unique_lock lock(mutex_);
        begin_.wait(lock, [&] { return stop_ || round_ != seen; });
        if (stop_) return;
        seen = round_;
      }
      take(thread);
      const std::lock_guard lock(mutex_);
      if (--busy_ == 0) end_.notify_one();
    }
  }

  std::mutex mutex_;
  std::condition_variable begin_, end_;
  const Work* work_ = nullptr;
  std::size_t count_ = 0, busy_ = 0;
  std::atomic<std::size_t> next_{0};
  long round_ = 0;
  bool stop_ = false;
  std::vector<std::thread> others_;
};

}  // namespace leglab::loop
