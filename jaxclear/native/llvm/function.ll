{error}
@message = internal constant [{length} x i8] c"{message}\00"
define ptr @{name}(ptr %frame) {{
entry:
  %extension_place = getelementptr i8, ptr %frame, i64 8
  %extension = load ptr, ptr %extension_place
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %execute, label %describe
describe:
  %metadata_place = getelementptr i8, ptr %extension, i64 24
  %metadata = load ptr, ptr %metadata_place
  %major = getelementptr i8, ptr %metadata, i64 24
  store i32 {major}, ptr %major
  %minor = getelementptr i8, ptr %metadata, i64 28
  store i32 {minor}, ptr %minor
  %traits = getelementptr i8, ptr %metadata, i64 32
  store i32 0, ptr %traits
  %state = getelementptr i8, ptr %metadata, i64 40
  store i64 0, ptr %state
  ret ptr null
execute:
  %attributes_place = getelementptr i8, ptr %frame, i64 160
  %attributes = load ptr, ptr %attributes_place
  %scalar = load ptr, ptr %attributes
  %number_place = getelementptr i8, ptr %scalar, i64 8
  %number_pointer = load ptr, ptr %number_place
  %number = load i64, ptr %number_pointer
  %table = inttoptr i64 {table} to ptr
  %first = and i64 %number, {mask}
  br label %probe
probe:
  %place = phi i64 [ %first, %execute ], [ %next, %further ], [ %first, %probe_anew ]
  %index = mul i64 %place, 2
  %pair = getelementptr i64, ptr %table, i64 %index
  %found = load atomic i64, ptr %pair acquire, align 8
  %hit = icmp eq i64 %found, %number
  br i1 %hit, label %enter, label %look
look:
  %empty = icmp eq i64 %found, 0
  br i1 %empty, label %missing, label %further
further:
  %following = add i64 %place, 1
  %next = and i64 %following, {mask}
  br label %probe
enter:
  %calls = inttoptr i64 {calls} to ptr
  %count = getelementptr i64, ptr %calls, i64 %place
  %before = atomicrmw add ptr %count, i64 1 seq_cst
  %address_place = getelementptr i64, ptr %pair, i64 1
  %address = load atomic i64, ptr %address_place seq_cst, align 8
  %still = load atomic i64, ptr %pair seq_cst, align 8
  %own = icmp eq i64 %still, %number
  %there = icmp ne i64 %address, 0
  %known = and i1 %own, %there
  br i1 %known, label %call, label %leave
call:
  %kernel = inttoptr i64 %address to ptr
  %error = call ptr %kernel(ptr %frame)
  %during = atomicrmw sub ptr %count, i64 1 seq_cst
  ret ptr %error
leave:
  %after = atomicrmw sub ptr %count, i64 1 seq_cst
  br i1 %own, label %missing, label %probe_anew
probe_anew:
  br label %probe
missing:
  %made = call ptr @error(ptr %frame, ptr @message)
  ret ptr %made
}}
define void @{name}.enter(ptr %pair, i64 %number, i64 %address) {{
entry:
  %address_place = getelementptr i64, ptr %pair, i64 1
  store atomic i64 {changing}, ptr %pair seq_cst, align 8
  store atomic i64 %address, ptr %address_place seq_cst, align 8
  store atomic i64 %number, ptr %pair seq_cst, align 8
  ret void
}}
define i64 @{name}.leave(ptr %pair, ptr %count) {{
entry:
  %address_place = getelementptr i64, ptr %pair, i64 1
  %address = atomicrmw xchg ptr %address_place, i64 0 seq_cst
  %calls = load atomic i64, ptr %count seq_cst, align 8
  ret i64 %calls
}}
